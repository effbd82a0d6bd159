"""Channels that end at a number, and rows that the logger repeated: what there is no measurement.

Samples on the end of a torque channel are the same, and far more than chance has. A torque with
noise comes to its extreme once. Where it is written in coarse steps it may come there often, but
then as often to the steps next to it; of a sine, whose peak is flat, 2.4 times as often at most.
Where steps are so coarse that the torque stays on them from row to row, anywhere, an extreme tells
nothing, unless the description says that it is the drive's limit.

Equal rows alone do not prove that the logger repeated one: a robot at rest gives them, and so do
coarse steps at a high rate. Held rows betray themselves by the jump at their end, which is as long
as the way of all of them.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.recording.masks.masks import NONE, Mask, Runs, joined, runs_of

# Levels next to the extreme that it is compared with, and how many times as often it is met.
_NEXT_TO, _OFTEN = 4, 8
# So many equal samples at an extreme at least; at a limit of the description so many.
_EQUAL, _AT_LIMIT = 4, 2
# Off either extreme the torque may stay what it is from row to row in this share of them.
_STAYS = 0.25
# An extreme below this share of the largest torque is no end of a channel.
_SMALL = 0.1
# A torque is at a limit of the description within this share of it.
_CLOSE = 1e-3
Rows = Float[np.ndarray, "_ _"]
# Positions jump by so many steps of the encoder, and so many times as far as from row to row
# before and after.
_STEPS, _FARTHER = 3.0, 1.5
# Rows on either side of a bridge, half as many as it is long, and the degree of the polynomial that
# fits them all; a lower one over a bridge much longer than what is beside it.
_FEWEST, _BESIDE, _DEGREE, _STIFF = 6, 32, 5, 3


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
        for _ in range(_NEXT_TO + 1):
            if not counted.size:
                break
            level = float(counted.max())
            at = counted == level
            self._levels[level] = self._levels.get(level, 0) + int(at.sum())
            counted = counted[~at]
        kept = sorted(self._levels, reverse=True)[: _NEXT_TO + 1]
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


class StaleSearch:
    """Looks for held rows in consecutive batches; `add` them, then read `runs`."""

    def __init__(self, dof: int) -> None:
        self._dof, self._count, self._judged = dof, 0, False
        self._rows, self._q = np.zeros(0, dtype=np.int64), np.zeros((0, dof))
        self._last: np.ndarray | float = np.nan
        self._found = [NONE]

    def add(
        self, values: Float[np.ndarray, "rows channels"], step: Float[np.ndarray, " dof"]
    ) -> np.ndarray:
        """Take in rows without their time, positions first; which of them are new.

        Args:
            step: of each position's encoder, as far as it is known by now.
        """
        new = np.any(np.diff(values, axis=0, prepend=self._last) != 0, axis=1)
        self._last = values[-1:].copy()
        self._rows = np.concatenate([self._rows, self._count + np.flatnonzero(new)])
        self._q = np.concatenate([self._q, values[new, : self._dof]])
        self._count += len(values)
        self._look(step)
        self._rows, self._q = self._rows[-3:], self._q[-3:]
        return new

    def runs(self, step: Float[np.ndarray, " dof"]) -> Runs:
        """All held rows, those at the end of the log included."""
        if len(self._rows) >= 2 and self._count - 1 > self._rows[-1]:
            way = np.abs(self._q[-1] - self._q[-2]) / (self._rows[-1] - self._rows[-2])
            if np.any((way >= _STEPS * step) & (way > 0)):
                self._found.append(np.array([[self._rows[-1] + 1, self._count - 1]]))
        return np.concatenate(self._found)

    def _look(self, step: Float[np.ndarray, " dof"]) -> None:
        """Gaps between new rows whose jump is known with the rows about it.

        The last three new rows are seen again with the next batch: of their two gaps the second is
        judged then, when the way after its jump is there.
        """
        gaps = np.diff(self._rows)
        if len(gaps) < 2:
            return
        ways = np.abs(np.diff(self._q, axis=0))
        pace = ways / gaps[:, None]
        before = np.concatenate([np.zeros((1, self._dof)), pace[:-2]])
        beside = np.maximum(before, pace[1:])
        jumps = (ways[:-1] >= _STEPS * step) & (ways[:-1] > _FARTHER * beside)
        held = (gaps[:-1] > 1) & jumps.any(axis=1)
        held[0] &= not self._judged
        self._judged = True
        at = np.flatnonzero(held)
        self._found.append(np.column_stack([self._rows[at] + 1, self._rows[at + 1] - 1]))


def bridged(blocks: Iterable[Rows], stale: Iterable[Mask], recorded: slice) -> Iterator[Rows]:
    """Consecutive rows in blocks, with a smooth motion in the place of stale ones.

    Args:
        stale: which these are.
        recorded: columns of positions, velocities and accelerations.
    """
    runs = np.array([(mask.first, mask.last) for mask in stale], dtype=np.int64).reshape(-1, 2)
    parts, given, known = list[Rows](), 0, 0
    for block in chain(blocks, [None]):
        if block is not None:
            parts.append(block)
            known += len(block)
            # A bridge needs rows that follow.
            if np.any((runs[:, 0] < known) & (runs[:, 1] + _BESIDE >= known)):
                continue
        if sum(map(len, parts)) > given:
            values = np.concatenate(parts)
            start = known - len(values)
            near = runs[(runs[:, 1] >= start + given) & (runs[:, 0] < known)] - start
            if len(near):
                motion = values[:, recorded].copy()
                bridge(motion, near)
                values[:, recorded] = motion
            yield values[given:]
            parts, given = [values[-_BESIDE:]], min(_BESIDE, len(values))


def bridge(values: Float[np.ndarray, "rows channels"], runs: Runs) -> None:
    """Put a smooth motion in the place of some rows, from those on either side.

    Args:
        values: evenly spaced rows of positions and their derivatives, changed in place.
        runs: of rows to replace.
    """
    held = np.zeros(len(values), dtype=bool)
    for first, last in runs:
        held[first : last + 1] = True
    good = np.flatnonzero(~held)
    for first, last in runs:
        at = np.searchsorted(good, first)
        beside = int(np.clip((last - first + 1) // 2, _FEWEST, _BESIDE))
        near = good[max(0, at - beside) : at + beside]
        if not len(near):
            continue
        middle, half = 0.5 * (near[0] + near[-1]), max(0.5 * (near[-1] - near[0]), 1.0)
        one_sided = at == 0 or at == len(good)
        highest = _STIFF if last - first > 3 * beside else _DEGREE
        degree = 0 if one_sided else min(highest, len(near) - 1)
        powers = np.vander((near - middle) / half, degree + 1)
        level = values[near].mean(axis=0)
        fit, *_ = np.linalg.lstsq(powers, values[near] - level, rcond=None)
        there = np.arange(first, last + 1)
        values[first : last + 1] = np.vander((there - middle) / half, degree + 1) @ fit + level
