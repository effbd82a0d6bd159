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

from deltaid.recording.masks.masks import NONE, Mask, Runs, as_runs, joined, runs_of

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
_FEWEST, _BESIDE, DEGREE, _STIFF = 6, 32, 5, 3


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
        before, counted = self.level, torque[new]
        for _ in range(_NEXT_TO + 1):
            if not counted.size:
                break
            level = float(counted.max())
            others = counted[counted != level]
            self._levels[level] = self._levels.get(level, 0) + len(counted) - len(others)
            counted = others
        self._levels = dict(sorted(self._levels.items(), reverse=True)[: _NEXT_TO + 1])
        if self.level > before:
            self._found.clear()
        at = torque == self.level
        elsewhere = new[1:] & ~at[1:] & (torque[1:] > torque.min())
        stays = int(np.count_nonzero(elsewhere & (torque[1:] == torque[:-1])))
        self._stayed += stays
        self._moved += int(np.count_nonzero(elsewhere)) - stays
        self._found.append(runs_of(at, row))

    @property
    def level(self) -> float:
        """The largest torque so far."""
        return max(self._levels, default=-np.inf)

    def runs(self, torque_max: float) -> Runs:
        """Rows at the extreme if it is the end of the channel; none otherwise.

        Args:
            torque_max: largest |τ| of the drive.
        """
        (top, count), *others = self._levels.items()
        beside = max((n for _, n in others), default=count)
        often = count >= _EQUAL + _OFTEN * (beside - 1) and self._stayed <= _STAYS * self._moved
        near = np.isfinite(self.limit) and abs(abs(top) - self.limit) <= _CLOSE * self.limit
        limited = near and count >= max(_AT_LIMIT, beside + 1)
        is_end = abs(top) >= _SMALL * torque_max and (often or limited)
        return joined(np.concatenate(self._found)) if is_end else NONE


class StaleSearch:
    """Looks for held rows in consecutive batches; `add` them, then read `runs`."""

    def __init__(self, dof: int) -> None:
        self._dof, self._count, self._judged = dof, 0, False
        self._rows, self._q = np.zeros(0, dtype=np.int64), np.zeros((0, dof))
        self._last, self._found = np.array(np.nan), [NONE]

    def add(
        self, values: Float[np.ndarray, "rows channels"], step: Float[np.ndarray, " dof"]
    ) -> np.ndarray:
        """Take in rows without their time, positions first; which of them are new.

        The last three new rows are looked at again with the next batch: of their two gaps the
        second is judged then, when the way after its jump is there.

        Args:
            step: of each position's encoder, as far as it is known by now.
        """
        new = np.any(np.diff(values, axis=0, prepend=self._last) != 0, axis=1)
        rows = np.concatenate([self._rows, self._count + np.flatnonzero(new)])
        q = np.concatenate([self._q, values[new, : self._dof]])
        self._last, self._rows, self._q = values[-1:].copy(), rows[-3:], q[-3:]
        self._count += len(values)
        gaps, ways = np.diff(rows), np.abs(np.diff(q, axis=0))
        if len(gaps) >= 2:
            pace = ways / gaps[:, None]
            beside = np.maximum(np.concatenate([np.zeros((1, self._dof)), pace[:-2]]), pace[1:])
            jumps = (ways[:-1] >= _STEPS * step) & (ways[:-1] > _FARTHER * beside)
            held = (gaps[:-1] > 1) & jumps.any(axis=1)
            held[0] &= not self._judged
            self._judged, at = True, np.flatnonzero(held)
            self._found.append(np.column_stack([rows[at] + 1, rows[at + 1] - 1]))
        return new

    def runs(self, step: Float[np.ndarray, " dof"]) -> Runs:
        """All held rows, those at the end of the log included."""
        if len(self._rows) >= 2 and self._count - 1 > self._rows[-1]:
            way = np.abs(self._q[-1] - self._q[-2]) / (self._rows[-1] - self._rows[-2])
            if np.any((way >= _STEPS * step) & (way > 0)):
                self._found.append(np.array([[self._rows[-1] + 1, self._count - 1]]))
        return np.concatenate(self._found)


def bridged(blocks: Iterable[Rows], stale: Iterable[Mask], recorded: slice) -> Iterator[Rows]:
    """Consecutive rows in blocks, with a smooth motion in the place of stale ones.

    Args:
        stale: which these are.
        recorded: columns of positions, velocities and accelerations.
    """
    runs = as_runs((mask.first, mask.last) for mask in stale)
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
    rows = np.arange(len(values))
    good = np.setdiff1d(rows, np.concatenate([rows[first : last + 1] for first, last in runs]))
    for first, last in runs:
        at = np.searchsorted(good, first)
        beside = int(np.clip((last - first + 1) // 2, _FEWEST, _BESIDE))
        near = good[max(0, at - beside) : at + beside]
        if not len(near):
            continue
        middle, half = 0.5 * (near[0] + near[-1]), max(0.5 * (near[-1] - near[0]), 1.0)
        highest = _STIFF if last - first > 3 * beside else DEGREE
        degree = 0 if at in (0, len(good)) else min(highest, len(near) - 1)
        level, there = values[near].mean(axis=0), rows[first : last + 1]
        powers = np.vander((near - middle) / half, degree + 1)
        fit, *_ = np.linalg.lstsq(powers, values[near] - level, rcond=None)
        values[there] = np.vander((there - middle) / half, degree + 1) @ fit + level
