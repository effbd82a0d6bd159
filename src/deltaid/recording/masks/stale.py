"""Rows that the logger repeated while the robot moved, and what positions were there.

Equal rows alone are no proof: a robot at rest gives them, and so do coarse steps at a high rate.
Held rows betray themselves by the jump at their end, which is as long as the way of all of them.
"""

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.recording.masks.masks import Mask
from deltaid.recording.masks.runs import NONE, Runs

Rows = Float[np.ndarray, "_ _"]

# Positions jump by so many steps of the encoder, and so many times as far as from row to row
# before and after.
_STEPS, _FARTHER = 3.0, 1.5
# Rows on either side of a bridge, half as many as it is long, and the degree of the polynomial that
# fits them all; a lower one over a bridge much longer than what is beside it.
_FEWEST, _BESIDE, _DEGREE, _STIFF = 6, 32, 5, 3


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
