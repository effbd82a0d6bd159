"""Detects saturated torque channels and rows that the logger repeated, and bridges the latter.

Samples at the end of a torque channel are equal, and far more frequent than by chance. A torque
with noise reaches its extreme once. In coarse steps it may do so often, but then it reaches the
next steps as often; a sine, whose peak is flat, reaches its extreme at most 2.4 times as often. If
steps are so coarse that the torque repeats elsewhere too, an extreme counts as saturated only at
the drive's described limit. Rows in which all drives hold their torques until the next update do
not count as repetitions.

Equal rows alone do not prove that the logger repeated one: a robot at rest has them, and so do
coarse steps at a high rate. Repeated rows end with a jump as long as their whole travel.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from jaxtyping import Float

from deltaid.levels import HARDLY
from deltaid.recording.columns import Rows
from deltaid.recording.masks.masks import NONE, Mask, Runs, as_runs, joined, runs_of

# Number of levels next to the extreme, and least ratio of its frequency to theirs.
_NEXT_TO, _OFTEN = 4, 8
# Fewest equal samples at an extreme.
_EQUAL = 4
# A torque that is so many times all others is none: a channel's end lies next to others.
NO_TORQUE = 10.0
# Largest ratio of repetitions to changes of the torque away from its extremes.
_STAYS = 0.25
# Least extreme at the end of a channel, as a share of the largest torque.
_SMALL = 0.1
# Least jump of positions after repeated rows, in encoder steps, and in changes per row before and
# after it.
_STEPS, _FARTHER = 3.0, 1.5
# Bridges: fewest and most rows on either side, which are half its length between these limits;
# degree of the polynomial, and its degree for bridges much longer than these rows.
FEWEST, _BESIDE, DEGREE, STIFF = 6, 32, 5, 3


@dataclass
class Extreme:
    """Running search for saturation at one end of a torque channel; `add` rows, then read `runs`.

    Attributes:
        limit: described limit of the drive [N m or N]; infinite without one.
    """

    limit: float = np.inf
    _levels: dict[float, int] = field(default_factory=dict[float, int])
    _runs: list[Runs] = field(default_factory=list[Runs])
    _moved: int = 0
    _stayed: int = 0

    def add(self, torque: Float[np.ndarray, " rows"], updated: np.ndarray, row: int) -> None:
        """Add rows, of which only `updated` ones are counted: those in which some drive's torque
        changes."""
        before, counted = self.level, torque[updated]
        for _ in range(_NEXT_TO + 1):
            if not counted.size:
                break
            level = float(counted.max())
            others = counted[counted != level]
            self._levels[level] = self._levels.get(level, 0) + len(counted) - len(others)
            counted = others
        self._levels = dict(sorted(self._levels.items(), reverse=True)[: _NEXT_TO + 1])
        if self.level > before:
            self._runs.clear()
        at = torque == self.level
        elsewhere = updated[1:] & ~at[1:] & (torque[1:] > torque.min())
        stays = int(np.count_nonzero(elsewhere & (torque[1:] == torque[:-1])))
        self._stayed += stays
        self._moved += int(np.count_nonzero(elsewhere)) - stays
        self._runs.append(runs_of(at, row))

    @property
    def level(self) -> float:
        return max(self._levels, default=-np.inf)

    def is_placeholder(self, other: float) -> bool:
        """Whether the extreme stands for a missing torque: often and far beyond all others, of
        which `other` is at the other end."""
        (top, count), *others = self._levels.items()
        largest = max(abs(other), *(abs(level) for level, _ in others), 0.0)
        return count >= _EQUAL and abs(top) > NO_TORQUE * largest > 0

    @property
    def first_row(self) -> int:
        """Of those at the extreme."""
        return int(np.concatenate(self._runs)[0, 0])

    def runs(self, torque_max: float) -> Runs:
        """Rows at the extreme if it is the end of the channel; else none.

        Args:
            torque_max: largest |τ| of the drive [N m or N].
        """
        (top, count), *others = self._levels.items()
        neighbours = max((n for _, n in others), default=count)
        often = count >= _EQUAL + _OFTEN * (neighbours - 1) and self._stayed <= _STAYS * self._moved
        near = np.isfinite(self.limit) and abs(abs(top) - self.limit) <= HARDLY * self.limit
        limited = near and count > neighbours
        is_end = abs(top) >= _SMALL * torque_max and (often or limited)
        return joined(np.concatenate(self._runs)) if is_end else NONE


class StaleSearch:
    """Running search for repeated rows; `add` consecutive batches, then read `runs`."""

    def __init__(self, dof: int) -> None:
        self._dof, self._count, self._judged = dof, 0, False
        self._rows, self._q = np.zeros(0, dtype=np.int64), np.zeros((0, dof))
        self._last, self._runs = np.array(np.nan), [NONE]

    def add(
        self, values: Float[np.ndarray, "rows channels"], step: Float[np.ndarray, " dof"]
    ) -> np.ndarray:
        """Add rows without their time, positions first; returns whether each row is new.

        The last three new rows are kept for the next batch: the second of their two gaps is judged
        with the change after its jump.

        Args:
            step: smallest step of each encoder so far [rad or m].
        """
        new = np.any(np.diff(values, axis=0, prepend=self._last) != 0, axis=1)
        rows = np.concatenate([self._rows, self._count + np.flatnonzero(new)])
        q = np.concatenate([self._q, values[new, : self._dof]])
        self._last, self._rows, self._q = values[-1:].copy(), rows[-3:], q[-3:]
        self._count += len(values)
        gaps, changes = np.diff(rows), np.abs(np.diff(q, axis=0))
        if len(gaps) >= 2:
            pace = changes / gaps[:, None]
            around = np.maximum(np.concatenate([np.zeros((1, self._dof)), pace[:-2]]), pace[1:])
            jumps = (changes[:-1] >= _STEPS * step) & (changes[:-1] > _FARTHER * around)
            held = (gaps[:-1] > 1) & jumps.any(axis=1)
            held[0] &= not self._judged
            self._judged, at = True, np.flatnonzero(held)
            self._runs.append(np.column_stack([rows[at] + 1, rows[at + 1] - 1]))
        return new

    def runs(self, step: Float[np.ndarray, " dof"]) -> Runs:
        """All repeated rows, including those at the end of the log."""
        if len(self._rows) >= 2 and self._count - 1 > self._rows[-1]:
            change = np.abs(self._q[-1] - self._q[-2]) / (self._rows[-1] - self._rows[-2])
            if np.any((change >= _STEPS * step) & (change > 0)):
                self._runs.append(np.array([[self._rows[-1] + 1, self._count - 1]]))
        return np.concatenate(self._runs)


def bridged(blocks: Iterable[Rows], stale: Iterable[Mask], recorded: slice) -> Iterator[Rows]:
    """Replace stale rows by a smooth motion.

    Args:
        blocks: consecutive rows in blocks.
        stale: masks of the stale rows.
        recorded: columns of positions, velocities and accelerations.
    """
    runs = as_runs((mask.first, mask.last) for mask in stale)
    parts, given, known = list[Rows](), 0, 0
    for block in chain(blocks, [None]):
        if block is not None:
            parts.append(block)
            known += len(block)
            # A bridge also needs the rows behind it.
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
    """Replace rows by a polynomial through those on either side.

    Args:
        values: evenly spaced rows of positions and their derivatives, changed in place.
        runs: runs of the rows to replace.
    """
    rows = np.arange(len(values))
    good = np.setdiff1d(rows, np.concatenate([rows[first : last + 1] for first, last in runs]))
    for first, last in runs:
        at = np.searchsorted(good, first)
        side = int(np.clip((last - first + 1) // 2, FEWEST, _BESIDE))
        near = good[max(0, at - side) : at + side]
        if not len(near):
            continue
        middle, half = 0.5 * (near[0] + near[-1]), max(0.5 * (near[-1] - near[0]), 1.0)
        highest = STIFF if last - first > 3 * side else DEGREE
        degree = 0 if at in (0, len(good)) else min(highest, len(near) - 1)
        level, there = values[near].mean(axis=0), rows[first : last + 1]
        powers = np.vander((near - middle) / half, degree + 1)
        fit, *_ = np.linalg.lstsq(powers, values[near] - level, rcond=None)
        values[there] = np.vander((there - middle) / half, degree + 1) @ fit + level
