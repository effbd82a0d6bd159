"""Detects torque channels that repeat a number while their drives move, as a lost channel does.

Torques repeat by chance: the next is the same with some probability, which is the higher the
coarser their steps are, and runs of equal numbers become exponentially rarer with their length. A
torque that is held until its next update has runs of one length. Runs say nothing where the noise
is within a step: such a torque stays the same where it is flat.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, Shaped

from deltaid.levels import NEVER
from deltaid.recording.masks.masks import NOISY, NONE, Runs, as_runs, joined, runs_of

# Longest runs of a channel that are kept.
_KEPT = 1000


@dataclass
class FrozenSearch:
    """Running search of a torque channel for runs of equal numbers; `add` rows, then read `runs`.

    A run is its first and last row, and the travel of its drive; blocks cut runs in parts.
    """

    _before: Float[np.ndarray, "2 rows"] = field(default_factory=lambda: np.zeros((2, 0)))
    _counts: dict[int, int] = field(default_factory=dict[int, int])  # of runs, by their length
    _longest: Float[np.ndarray, "runs 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    _step: float = np.inf
    # changes of the torque, those that reverse the one before, and those over several steps
    _changes: int = 0
    _reversed: int = 0
    _wide: int = 0

    def add(
        self, torque: Float[np.ndarray, " rows"], q: Float[np.ndarray, " rows"], row: int
    ) -> None:
        """Add consecutive rows; `row` is the number of the first one."""
        row -= self._before.shape[1]
        torque, q = block = np.hstack([self._before, [torque, q]])
        self._before, change = block[:, -1:], np.diff(torque)
        runs = runs_of(change == 0, row) + np.array([0, 1])
        change = change[change != 0]
        size = np.abs(change)
        self._step = min(self._step, size.min(initial=np.inf))
        self._changes += len(size)
        self._reversed += int(np.count_nonzero(change[1:] * change[:-1] < 0))
        self._wide += int(np.count_nonzero(size > 1.5 * self._step))
        lengths, counts = np.unique(_lengths(runs), return_counts=True)
        self._counts[1] = self._counts.get(1, 0) + len(change) - len(runs)
        for length, count in zip(lengths.tolist(), counts.tolist(), strict=True):
            self._counts[length] = self._counts.get(length, 0) + count
        ends = (runs - row + np.array([0, 1])).ravel()
        places = np.append(q, q[-1:])  # a run may end with the block
        low, high = (end.reduceat(places, ends)[::2] for end in (np.minimum, np.maximum))
        longest = np.concatenate([self._longest, np.column_stack([runs, high - low])])
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
        rare = count * longer ** ((_lengths(self._longest) - 1) // usual) < NEVER
        frozen = self._longest[rare & (self._longest[:, 2] > still), :2]
        return joined(as_runs(sorted(frozen.astype(np.int64).tolist())))


def _lengths(runs: Shaped[np.ndarray, "runs _"]) -> Int[np.ndarray, " runs"]:
    return (runs[:, 1] - runs[:, 0] + 1).astype(np.int64)
