"""Torque channels that end at a number: samples on it are the same, and far more than chance has.

A torque with noise comes to its extreme once. Where it is written in coarse steps it may come there
often, but then as often to the steps next to it; of a sine, whose peak is flat, 2.4 times as often
at most. Where steps are so coarse that the torque stays on them from row to row, anywhere, an
extreme tells nothing, unless the description says that it is the drive's limit.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.recording.masks.runs import NONE, Runs, joined, runs_of

# Levels next to the extreme that it is compared with, and how many times as often it is met.
_BESIDE, _OFTEN = 4, 8
# So many equal samples at an extreme at least; at a limit of the description so many.
_EQUAL, _AT_LIMIT = 4, 2
# Off either extreme the torque may stay what it is from row to row in this share of them.
_STAYS = 0.25
# An extreme below this share of the largest torque is no end of a channel.
_SMALL = 0.1
# A torque is at a limit of the description within this share of it.
_CLOSE = 1e-3


@dataclass
class Extreme:
    """One end of one torque channel; `add` consecutive rows, then read `runs`.

    Attributes:
        limit: of the drive by its description [N m or N]; infinite if there is none.
    """

    limit: float = np.inf
    _levels: dict[float, int] = field(default_factory=dict[float, int])
    _found: list[Runs] = field(default_factory=list[Runs])
    _moved: int = 0
    _stayed: int = 0

    def add(self, torque: Float[np.ndarray, " rows"], new: np.ndarray, row: int) -> None:
        """Take in rows; those that only repeat the one before are not `new`, and not counted."""
        before = self.level
        counted = torque[new]
        for _ in range(_BESIDE + 1):
            if not counted.size:
                break
            level = float(counted.max())
            at = counted == level
            self._levels[level] = self._levels.get(level, 0) + int(at.sum())
            counted = counted[~at]
        kept = sorted(self._levels, reverse=True)[: _BESIDE + 1]
        self._levels = {level: self._levels[level] for level in kept}
        if self.level > before:
            self._found.clear()
        at = torque == self.level
        elsewhere = new[1:] & ~at[1:] & (torque[1:] > torque.min())
        stays = int(np.count_nonzero(elsewhere & (torque[1:] == torque[:-1])))
        self._stayed += stays
        self._moved += int(np.count_nonzero(elsewhere)) - stays
        here = runs_of(at, row)
        if len(here):
            self._found.append(here)

    @property
    def level(self) -> float:
        """The largest torque so far."""
        return max(self._levels, default=-np.inf)

    def runs(self, torque_max: float) -> Runs:
        """Rows at the extreme if it is the end of the channel; none otherwise.

        Args:
            torque_max: largest |τ| of the drive.
        """
        (top, count), *others = sorted(self._levels.items(), reverse=True)
        beside = max((n for _, n in others), default=count)
        often = count >= _EQUAL + _OFTEN * (beside - 1) and self._stayed <= _STAYS * self._moved
        near = np.isfinite(self.limit) and abs(abs(top) - self.limit) <= _CLOSE * self.limit
        limited = near and count >= _AT_LIMIT
        if abs(top) < _SMALL * torque_max or not (often or (limited and count > beside)):
            return NONE
        return joined(np.concatenate(self._found))
