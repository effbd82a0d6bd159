"""What of a recording is left out, because it is no motion under power of the drives.

Runs are consecutive rows that have something in common, as first and last row."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from deltaid.errors import RecordingError

Runs = Int[np.ndarray, "_ 2"]

NONE: Runs = np.zeros((0, 2), dtype=np.int64)
# A recording is refused where less than this share of the rows is left for a drive.
_LEAST = 0.02
Reason = Literal[
    "standing still",
    "on brakes",
    "before a stop",
    "emergency stop",
    "saturated torque",
    "stale rows",
    "load changes",
]
LOAD_CHANGES: Reason = "load changes"
# Why such rows say nothing, or something wrong, about the drives' torques.
WHY: dict[Reason, str] = {
    "standing still": "at rest friction is whatever balances the torque",
    "on brakes": "at rest with the torque off or constant; the brakes hold the robot",
    "before a stop": "the low-pass of the positions sees the brakes' jerk ahead of it",
    "emergency stop": "brakes slow the robot down, the drives are without torque",
    "saturated torque": "on the largest or smallest number of its channel; the torque went on",
    "stale rows": "the logger repeated a row while the robot moved",
    "load changes": "a load is taken up or put down; when exactly is not known to a sample",
}


@dataclass(frozen=True)
class Mask:
    """Consecutive rows that are left out for some drives.

    Attributes:
        reason: why.
        drives: of these drives, counted from 0.
        first, last: rows of the log, counted from 0.
        start, end: when [s].
    """

    reason: Reason
    drives: tuple[int, ...]
    first: int
    last: int
    start: float
    end: float


def as_runs(pairs: Iterable[Sequence[int]]) -> Runs:
    """Runs from their first and last rows."""
    return np.array(list(pairs), dtype=np.int64).reshape(-1, 2)


def runs_of(flags: Bool[np.ndarray, " rows"], row: int = 0) -> Runs:
    """Runs of true flags, the first of which belongs to `row`."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return edges.reshape(-1, 2) + np.array([row, row - 1])


def joined(runs: Shaped[np.ndarray, "_ 2"], gap: int = 0) -> Shaped[np.ndarray, "_ 2"]:
    """Ascending runs without what is between two with no more than `gap` rows between them."""
    if not len(runs):
        return runs
    runs = np.column_stack([runs[:, 0], np.maximum.accumulate(runs[:, 1])])
    apart = np.flatnonzero(runs[1:, 0] - runs[:-1, 1] > gap + 1)
    return np.column_stack([runs[np.append(0, apart + 1), 0], runs[np.append(apart, -1), 1]])


def joined_times(spans: Float[np.ndarray, "_ 2"]) -> Float[np.ndarray, "_ 2"]:
    """Spans of time in any order as ascending ones that are apart from each other."""
    return joined(spans[np.argsort(spans[:, 0])], gap=-1)


def without(runs: Runs, others: Runs) -> Runs:
    """Ascending runs less the rows of others, which ascend as well."""
    kept = list[tuple[int, int]]()
    for first, last in runs.tolist():
        cuts = others[(others[:, 1] >= first) & (others[:, 0] <= last)]
        starts, stops = [first, *(cuts[:, 1] + 1).tolist()], [*cuts[:, 0].tolist(), last + 1]
        kept += [(a, b - 1) for a, b in zip(starts, stops, strict=True) if a < b]
    return as_runs(kept)


def within(
    spans: Shaped[np.ndarray, "_ 2"], x: Shaped[np.ndarray, " rows"]
) -> Bool[np.ndarray, " rows"]:
    """Which of ascending numbers lie in ascending spans that are apart, few of them near."""
    inside = np.zeros(len(x), dtype=bool)
    near = spans[(spans[:, 1] >= x[0]) & (spans[:, 0] <= x[-1])] if len(x) else NONE
    for start, stop in near:
        inside[np.searchsorted(x, start) : np.searchsorted(x, stop, side="right")] = True
    return inside


def rolling(
    x: Float[np.ndarray, "rows channels"], length: int
) -> tuple[Float[np.ndarray, "windows channels"], Float[np.ndarray, "windows channels"]]:
    """Least and largest value in every window of `length` rows."""
    return _extremes(np.minimum, x, length), _extremes(np.maximum, x, length)


def least_about(
    x: Float[np.ndarray, "rows channels"], reach: int
) -> Float[np.ndarray, "rows channels"]:
    """Least value within `reach` rows to either side; zero beyond the ends."""
    return _extremes(np.minimum, np.pad(x, ((reach, reach), (0, 0))), 2 * reach + 1)


def _extremes(
    extreme: np.ufunc, x: Float[np.ndarray, "rows channels"], length: int
) -> Float[np.ndarray, "windows channels"]:
    """Those of windows of `length` rows, from those of half as many: faster than SciPy's."""
    found, size = x, 1
    while size < length:
        step = min(size, length - size)
        found, size = extreme(found[:-step], found[step:]), size + step
    return found


def left_out(masks: Iterable[Mask], drive: int | None = None) -> Runs:
    """Ascending runs of rows without weight for a drive, or for any."""
    own = [mask for mask in masks if drive is None or drive in mask.drives]
    return joined(as_runs(sorted((mask.first, mask.last) for mask in own)))


def before_stops(masks: Iterable[Mask], cutoff: float, rate: float) -> tuple[Mask, ...]:
    """Masks with those rows in which a low-pass feels that brakes will set in.

    Acceleration jumps there, and the filtered one begins to change a period 1 / cutoff ahead: no
    torque goes with that.

    Args:
        cutoff: of the low-pass [Hz].
        rate: of the rows [Hz].
    """
    found = [mask for mask in masks if mask.reason != "before a stop"]
    for mask in [mask for mask in found if mask.reason == "emergency stop" and mask.first]:
        first, last = max(0, mask.first - math.ceil(rate / cutoff)), mask.first - 1
        times = (mask.start - (mask.first - row) / rate for row in (first, last))
        found.append(Mask("before a stop", mask.drives, first, last, *times))
    return tuple(sorted(found, key=lambda mask: (mask.first, mask.drives)))


def kept(masks: Sequence[Mask], drives: int, samples: int) -> Float[np.ndarray, " drives"]:
    """Share of the rows that is left of each drive."""
    lost = [np.sum(left_out(masks, i) @ [-1, 1] + 1) for i in range(drives)]
    return 1.0 - np.array(lost) / samples


def require_rest(masks: Sequence[Mask], samples: int, drives: Sequence[str], where: str) -> None:
    """Refuse a log of which next to nothing is left.

    Raises:
        RecordingError: with the drive, and what went for which reason.
    """
    left = kept(masks, len(drives), samples)
    i = int(np.argmin(left))
    if left[i] >= _LEAST:
        return
    shares = {
        reason: 1.0 - kept([m for m in masks if m.reason == reason], len(drives), samples)[i]
        for reason in dict.fromkeys(mask.reason for mask in masks if i in mask.drives)
    }
    reasons = ", ".join(f"{100 * share:.3g} % {reason}" for reason, share in shares.items())
    raise RecordingError(
        f"next to nothing is left for {drives[i]}: {reasons}",
        where=where,
        cure="record the robot while its drives move it and no channel is at its end, or take all "
        "rows by --keep-all",
    )
