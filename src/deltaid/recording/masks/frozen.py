"""Detects torque channels that repeat a number while their drives move, as a lost channel does.

Torques repeat by chance: the next is the same with some probability, which is the higher the
coarser their steps are, and runs of equal numbers become exponentially rarer with their length. A
torque that is held until its next update has runs of one length. Runs say nothing where the noise
is within a step: such a torque stays the same where it is flat.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from deltaid.levels import NEVER
from deltaid.recording.masks.masks import NONE, Runs, as_runs

# Share of changes that reverse the previous one above which a channel has noise: two thirds for
# white noise, hardly any for a smooth torque.
NOISY = 0.2
# Longest runs of a channel that are kept.
_KEPT = 1000


@dataclass
class FrozenSearch:
    """Running search of a torque channel for runs of equal numbers; `add` rows, then read `runs`.

    A run is its first and last row, and the smallest and largest position of its drive.
    """

    _counts: dict[int, int] = field(default_factory=dict[int, int])  # of runs, by their length
    _longest: Float[np.ndarray, "runs 4"] = field(default_factory=lambda: np.zeros((0, 4)))
    _open: Float[np.ndarray, "runs 4"] = field(default_factory=lambda: np.zeros((0, 4)))
    _numbers: Float[np.ndarray, " numbers"] = field(default_factory=lambda: np.zeros(0))
    _step: float = np.inf
    # changes of the torque, those that reverse the one before, and those over several steps
    _changes: int = 0
    _reversed: int = 0
    _wide: int = 0

    def add(
        self, torque: Float[np.ndarray, " rows"], q: Float[np.ndarray, " rows"], row: int
    ) -> None:
        """Add consecutive rows; `row` is the number of the first one."""
        starts = np.flatnonzero(np.diff(torque, prepend=np.nan) != 0)
        ends = np.append(starts[1:], len(torque)) - 1
        low, high = np.minimum.reduceat(q, starts), np.maximum.reduceat(q, starts)
        runs = np.column_stack([row + starts, row + ends, low, high])
        numbers = np.concatenate([self._numbers, torque[starts]])
        if len(self._open) and numbers[len(self._numbers) - 1] == torque[0]:
            numbers = np.delete(numbers, len(self._numbers))
            runs[0, 0], runs[0, 2] = self._open[0, 0], min(runs[0, 2], self._open[0, 2])
            runs[0, 3] = max(runs[0, 3], self._open[0, 3])
        else:
            runs = np.concatenate([self._open, runs])
        change = np.diff(numbers)
        size = np.abs(change[1:])
        self._step = min(self._step, size.min(initial=np.inf))
        self._changes += len(size)
        self._reversed += int(np.count_nonzero(change[1:] * change[:-1] < 0))
        self._wide += int(np.count_nonzero(size > 1.5 * self._step))
        self._numbers, self._open = numbers[-2:], runs[-1:]
        closed = runs[:-1]
        lengths, counts = np.unique(_lengths(closed), return_counts=True)
        for length, count in zip(lengths.tolist(), counts.tolist(), strict=True):
            self._counts[length] = self._counts.get(length, 0) + count
        longest = np.concatenate([self._longest, closed])
        self._longest = longest[np.argsort(-_lengths(longest), kind="stable")[:_KEPT]]

    def runs(self, still: float) -> Runs:
        """Runs that no chance explains, in which the position leaves a band of the width
        `still`."""
        if self._reversed <= NOISY * self._changes or 2 * self._wide <= self._changes:
            return NONE
        lengths, counts = np.array(sorted(self._counts.items())).T
        shorter, count = np.cumsum(counts), counts.sum()
        usual = 2 * lengths[np.searchsorted(shorter, 0.5 * count)]
        longer = max(1, counts[lengths > usual].sum()) / count
        runs = np.concatenate([self._longest, self._open])
        rare = count * longer ** ((_lengths(runs) - 1) // usual) < NEVER
        frozen = rare & (runs[:, 3] - runs[:, 2] > still)
        return as_runs(sorted(runs[frozen, :2].astype(np.int64).tolist()))


def _lengths(runs: Float[np.ndarray, "runs 4"]) -> Int[np.ndarray, " runs"]:
    return (runs[:, 1] - runs[:, 0] + 1).astype(np.int64)
