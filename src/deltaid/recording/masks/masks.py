"""Masks: rows of a recording that are excluded because drives do not power the motion there.

A run is the pair of the first and the last of consecutive rows with a common property.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from deltaid.errors import RecordingError

Runs = Int[np.ndarray, "_ 2"]

NONE: Runs = np.zeros((0, 2), dtype=np.int64)
# Share of its usual or largest motion below which a drive or robot rests.
RESTS = 0.01
# Share of changes that reverse the previous one above which a channel has noise: two thirds for
# white noise, hardly any for a smooth torque.
NOISY = 0.2
# Least share of rows that must remain for each drive.
_LEAST = 0.02
Reason = Literal[
    "standing still",
    "on brakes",
    "before a stop",
    "emergency stop",
    "saturated torque",
    "stale rows",
    "frozen torque",
    "load changes",
]
FROZEN: Reason = "frozen torque"
LOAD_CHANGES: Reason = "load changes"
# Explanations of the reasons.
WHY: dict[Reason, str] = {
    "standing still": "at rest friction is whatever balances the torque",
    "on brakes": "at rest with the torque off or constant; the brakes hold the robot",
    "before a stop": "the low-pass of the positions spreads the brakes' jerk to earlier rows",
    "emergency stop": "brakes slow the robot down, the drives are without torque",
    "saturated torque": "the channel is at its largest or smallest number, which torque exceeds",
    "stale rows": "the logger repeated a row while the robot moved",
    "frozen torque": "the channel repeats a number while its drive moves",
    "load changes": "a load is gripped or released; the time is not known to a sample",
}


@dataclass(frozen=True)
class Mask:
    """Consecutive rows that are excluded for some drives.

    Attributes:
        reason: reason of the exclusion.
        drives: indices of the drives.
        first, last: rows of the log, counted from 0.
        start, end: times of these rows [s].
    """

    reason: Reason
    drives: tuple[int, ...]
    first: int
    last: int
    start: float
    end: float


def as_runs(pairs: Iterable[Sequence[int]]) -> Runs:
    return np.array(list(pairs), dtype=np.int64).reshape(-1, 2)


def runs_of(flags: Bool[np.ndarray, " rows"], row: int = 0) -> Runs:
    """Runs of true flags; the first flag belongs to `row`."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return edges.reshape(-1, 2) + np.array([row, row - 1])


def joined(runs: Shaped[np.ndarray, "_ 2"], gap: int = 0) -> Shaped[np.ndarray, "_ 2"]:
    """Join ascending runs between which lie at most `gap` rows."""
    if not len(runs):
        return runs
    runs = np.column_stack([runs[:, 0], np.maximum.accumulate(runs[:, 1])])
    apart = np.flatnonzero(runs[1:, 0] - runs[:-1, 1] > gap + 1)
    return np.column_stack([runs[np.append(0, apart + 1), 0], runs[np.append(apart, -1), 1]])


def joined_times(spans: Float[np.ndarray, "_ 2"]) -> Float[np.ndarray, "_ 2"]:
    """Convert spans of time in any order to disjoint ascending spans."""
    return joined(spans[np.argsort(spans[:, 0])], gap=-1)


def without(runs: Runs, others: Runs) -> Runs:
    """Ascending runs minus the rows of other ascending runs."""
    kept = list[tuple[int, int]]()
    for first, last in runs.tolist():
        cuts = others[(others[:, 1] >= first) & (others[:, 0] <= last)]
        starts, stops = [first, *(cuts[:, 1] + 1).tolist()], [*cuts[:, 0].tolist(), last + 1]
        kept += [(a, b - 1) for a, b in zip(starts, stops, strict=True) if a < b]
    return as_runs(kept)


def within(
    spans: Shaped[np.ndarray, "_ 2"], x: Shaped[np.ndarray, " rows"]
) -> Bool[np.ndarray, " rows"]:
    """Whether ascending numbers lie in disjoint ascending spans."""
    ends = np.append(-np.inf, spans[:, 1])
    return x <= ends[np.searchsorted(spans[:, 0], x, side="right")]


def rolling(
    x: Float[np.ndarray, "rows channels"], length: int
) -> tuple[Float[np.ndarray, "windows channels"], Float[np.ndarray, "windows channels"]]:
    """Least and largest values in all windows of `length` rows."""
    return _extremes(np.minimum, x, length), _extremes(np.maximum, x, length)


def least_about(
    x: Float[np.ndarray, "rows channels"], reach: int
) -> Float[np.ndarray, "rows channels"]:
    """Least value within `reach` rows to either side; zero beyond the ends."""
    return _extremes(np.minimum, np.pad(x, ((reach, reach), (0, 0))), 2 * reach + 1)


def _extremes(
    extreme: np.ufunc, x: Float[np.ndarray, "rows channels"], length: int
) -> Float[np.ndarray, "windows channels"]:
    """Extremes of windows, by doubling their length, which is faster than SciPy's filters."""
    extremes, size = x, 1
    while size < length:
        step = min(size, length - size)
        extremes, size = extreme(extremes[:-step], extremes[step:]), size + step
    return extremes


def left_out(masks: Iterable[Mask], drive: int | None = None) -> Runs:
    """Ascending runs of rows that are excluded for a drive, or for any."""
    runs = ((m.first, m.last) for m in masks if drive is None or drive in m.drives)
    return joined(as_runs(sorted(runs)))


def before_stops(masks: Iterable[Mask], cutoff: float, rate: float) -> tuple[Mask, ...]:
    """Add masks of the rows ahead of emergency stops that the low-pass affects.

    Brakes make the acceleration jump. The filtered acceleration changes from a period 1 / cutoff
    ahead of the jump, without a torque.

    Args:
        masks: masks of a survey; those before stops are replaced.
        cutoff: cut-off of the low-pass [Hz].
        rate: sampling rate [Hz].
    """
    kept_masks = [mask for mask in masks if mask.reason != "before a stop"]
    for mask in [mask for mask in kept_masks if mask.reason == "emergency stop" and mask.first]:
        first, last = max(0, mask.first - math.ceil(rate / cutoff)), mask.first - 1
        times = (mask.start - (mask.first - row) / rate for row in (first, last))
        kept_masks.append(Mask("before a stop", mask.drives, first, last, *times))
    return tuple(sorted(kept_masks, key=lambda mask: (mask.first, mask.drives)))


def kept_shares(masks: Sequence[Mask], drives: int, samples: int) -> Float[np.ndarray, " drives"]:
    """Share of rows that remain for each drive."""
    lost = [np.sum(left_out(masks, i) @ [-1, 1] + 1) for i in range(drives)]
    return 1.0 - np.array(lost) / samples


def require_rest(masks: Sequence[Mask], samples: int, drives: Sequence[str], where: str) -> None:
    """Refuse a log of which hardly any rows remain for some drive.

    Raises:
        RecordingError: names the drive, and the share of rows excluded for each reason.
    """
    remaining = kept_shares(masks, len(drives), samples)
    i = int(np.argmin(remaining))
    if remaining[i] >= _LEAST:
        return
    shares = {
        reason: 1.0 - kept_shares([m for m in masks if m.reason == reason], len(drives), samples)[i]
        for reason in dict.fromkeys(mask.reason for mask in masks if i in mask.drives)
    }
    reasons = ", ".join(f"{100 * share:.3g} % {reason}" for reason, share in shares.items())
    raise RecordingError(
        f"next to nothing is left for {drives[i]}: {reasons}",
        where=where,
        cure="record the robot while its drives move it and no channel is at its end, or take all "
        "rows by --keep-all",
    )
