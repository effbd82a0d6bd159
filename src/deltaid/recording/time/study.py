"""Determines the clock of a recording with unsteady rows, in a separate pass.

Positions determine missing rows better than stamps that jitter by more than a tenth of a step, or
that rows share. At each hole that stamps suggest, polynomials are fitted to the positions without
the hole, and with the hole before each nearby row. The largest log-likelihood −½ n log s² decides,
with the squared residual s² of n rows.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.recording.columns import Rows
from deltaid.recording.masks.stuck import DEGREE
from deltaid.recording.source import BATCH_ROWS
from deltaid.recording.table import recut
from deltaid.recording.time.clock import JITTER, Clock
from deltaid.recording.time.grid import (
    ABOUT,
    ROUNDED,
    SHARP,
    Grid,
    far_steps,
    medians,
    place,
    repaired,
    spread,
    usual_step,
)
from deltaid.recording.time.signals import GAP, are_later, weights_at
from deltaid.recording.units import SIDE

# Rows at either end of a block whose places are ignored.
_EDGE = 1024
# Ratio of the roughness of positions over stamps to that over the grid below which samples are
# uneven; above its inverse they are even.
_CLEAR = 0.7
# Roughness below which positions count as free of noise [rad or m].
_SMOOTH = np.sqrt(np.finfo(float).eps)
Places = Int[np.ndarray, " _"]
# Distance within which a hole is searched: fewest rows, multiple of the jitter, most rows.
_NEAR, _REACH, _FARTHEST = 8, 4.0, 128
# Longest hole that positions determine [rows]; stamps determine longer ones.
_LONGEST = int(GAP)


def study(batches: Iterable[Rows], dof: int) -> Clock:
    """Clock of a recording from its rows: time, positions of the drives, other channels."""
    notes, start = _ClockStudy(dof), 0
    before: Rows | None = None
    for rows in chain(recut(batches, BATCH_ROWS), [None]):
        if before is not None:
            notes.add(before, start, last=rows is None)
            start += len(before) - 2 * _EDGE
            rows = None if rows is None else np.concatenate([before[-2 * _EDGE :], rows])
        before = rows
    return notes.clock()


@dataclass
class _Reading:
    """Running result of one interpretation of stamps: even or uneven samples.

    Attributes:
        holes: `holes`, `lost`, `since` and `until` of `Clock`, block by block.
        extra: excluded rows, block by block.
        sums: number of periods, their sum [s], and sum of squared deviations [s²].
    """

    holes: list[np.ndarray] = field(default_factory=list[np.ndarray])
    extra: list[np.ndarray] = field(default_factory=list[np.ndarray])
    sums: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def add(self, time: np.ndarray, kept: Places, lost: Places, inner: range, start: int) -> None:
        """Add the `inner` rows of a block that begins with row `start`."""
        at = np.flatnonzero((kept >= inner.start) & (kept < inner.stop) & (lost != 0))
        stamps = time[kept[at - 1]], time[kept[at]]
        self.holes.append(np.array([kept[at] + start, lost[at], *stamps]))
        self.extra.append(np.setdiff1d(np.arange(inner.start, inner.stop), kept) + start)


class _ClockStudy:
    """Running state over overlapping blocks: both readings, and which one positions follow."""

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self.rows = self.doubled = 0
        self.first = self.last = np.nan
        self.wild = np.zeros(0, dtype=int)
        self.even, self.uneven = _Reading(), _Reading()
        self.rounded = False
        self.by_grid, self.by_stamps = np.zeros((2, dof))

    def add(self, block: Rows, start: int, *, last: bool) -> None:
        """Add a block, without the rows at its ends that belong to neighbouring blocks."""
        inner = range(_EDGE if start else 0, len(block) if last else len(block) - _EDGE)
        time, wild = repaired(block[:, 0], *usual_step(block[:, 0]))
        self.first = self.first if self.rows else float(time[0])
        self.last = float(time[-1])
        if wild.any():
            block = np.column_stack([time, block[:, 1:]])
            rows = np.flatnonzero(wild[inner.start : inner.stop]) + inner.start + start
            self.wild = np.append(self.wild, rows)
        doubled = _doubled(block)
        self.doubled += int(np.count_nonzero(doubled[inner.start : inner.stop]))
        self.rows += len(inner)
        single = np.flatnonzero(~doubled)
        if wild[single].all():
            wild = np.zeros_like(wild)
        self._read_even(block, single, wild, inner, start)
        self._read_uneven(time, np.flatnonzero(~doubled & ~wild), inner, start)

    def _read_even(
        self, block: Rows, single: Places, wild: Bool[np.ndarray, " rows"], inner: range, start: int
    ) -> None:
        time = block[:, 0]
        if not np.ptp(time[single]) > 0:  # time stands
            self.even.add(time, single[:1], np.zeros(1, dtype=int), inner, start)
            return
        grid = place(time[single])
        kept = single[grid.kept]
        if spread(grid.off) > SHARP:
            grid = _revised(grid, block[kept, 1 : 1 + self.dof])
        # Where more consecutive rows have no place than a hole may have, the number of lost rows is
        # unknown.
        grid.lost[np.flatnonzero(np.diff(grid.kept) > _LONGEST + 1) + 1] = -1
        if wild.any():
            grid = grid.without(wild[kept])
            kept = single[grid.kept]
        self.even.add(time, kept, grid.lost, inner, start)
        inside = (kept >= inner.start) & (kept < inner.stop)
        off = grid.period * grid.off[inside]
        if off.size:
            self.even.sums += off.size, off.size * grid.period, off.size * np.var(off)
        index = np.cumsum(1 + np.maximum(grid.lost, 0)).astype(float)
        self._compare(index, time[kept] / grid.period, block[kept, 1 : 1 + self.dof], inside)

    def _read_uneven(self, time: np.ndarray, single: Places, inner: range, start: int) -> None:
        again = far_steps(time[single], usual_step(time[single])[0], 1.0)
        again = again[time[single[again]] < time[single[again - 1]]]
        later = [rows[are_later(time[rows])] for rows in np.split(single, again)]
        kept = np.concatenate(later)
        steps = np.diff(time[kept], prepend=time[kept[:1]])
        usual = float(np.median(steps[1:])) if len(steps) > 1 else 1.0
        far = steps > GAP * usual
        lost = np.where(far, np.round(steps / usual) - 1, 0).astype(int)
        restarts = np.cumsum([len(rows) for rows in later[:-1]], dtype=int)
        lost[restarts] = -1
        far[restarts] = True
        self.uneven.add(time, kept, lost, inner, start)
        near = steps[(kept >= max(inner.start, 1)) & (kept < inner.stop) & ~far]
        if near.size:
            self.uneven.sums += near.size, near.sum(), near.size * np.var(near) / 2

    def _compare(
        self,
        index: Float[np.ndarray, " kept"],
        time: Float[np.ndarray, " kept"],
        q: Float[np.ndarray, "kept dof"],
        inner: Bool[np.ndarray, " kept"],
    ) -> None:
        """Add the roughness of positions over the grid and over the stamps [periods]."""
        steps = np.diff(time)
        self.rounded |= bool(len(steps) > ROUNDED * np.count_nonzero(steps))
        if len(index) < 5:
            return
        close = [np.abs(index[4:] - index[:-4]) < 7, np.abs(time[4:] - time[:-4]) < 10]
        nearest = np.minimum.reduce([steps[k : len(steps) - 3 + k] for k in range(4)])
        inside = inner[2:-2] & close[0] & close[1] & (nearest > 0.05)
        grid, stamps = (np.abs(_roughness(x, q)[inside]).sum(axis=0) for x in (index, time))
        self.by_grid += grid
        self.by_stamps += stamps

    @property
    def is_even(self) -> bool | None:
        """Whether positions follow the grid; None if they do not determine it."""
        steps, total, squares = self.even.sums
        if self.rounded or squares * steps < (JITTER * total) ** 2:
            return True
        least = _SMOOTH * self.rows
        ratio = np.maximum(self.by_stamps, least) / np.maximum(self.by_grid, least)
        if ratio.max() > 1 / _CLEAR:
            return True
        return False if ratio.min() < _CLEAR else None

    def clock(self) -> Clock:
        even = self.is_even
        reading = self.uneven if even is False else self.even
        holes, lost, since, until = np.concatenate(reading.holes, axis=1)
        steps, total, squares = reading.sums.tolist()
        return Clock(
            period=total / max(1, steps),
            rows=self.rows,
            first=self.first,
            last=self.last,
            steady=False,
            even=even,
            jitter=float(np.sqrt(squares / max(1, steps))),
            wild=len(self.wild),
            first_wild=next(iter(self.wild.tolist()), -1),
            extra=np.concatenate(reading.extra),
            doubled=self.doubled,
            late=sum(map(len, reading.extra)) - self.doubled - len(self.wild),
            holes=holes.astype(int),
            lost=lost.astype(int),
            since=since,
            until=until,
        )


def _doubled(block: Rows) -> Bool[np.ndarray, " rows"]:
    """Whether each row repeats the row before it at almost the same time.

    If rows share stamps, equal rows of a resting robot are no repetition.
    """
    here, before = block[1:, 1:], block[:-1, 1:]
    same = (here == before) | (np.isnan(here) & np.isnan(before))
    equal = np.append(False, same.all(axis=1))
    if not equal.any():
        return equal
    usual, sharing = usual_step(block[:, 0])
    doubled = equal & (np.diff(block[:, 0], prepend=-np.inf) < 0.5 * usual)
    alone = equal & ~(np.append(equal[1:], False) | np.append(False, equal[:-1]))
    if sharing > ROUNDED:
        return doubled & alone if usual else equal  # all of them if time stands still
    # Repetitions with new stamps make more rows in the same time.
    level = medians(block[:, 0] / usual - np.arange(len(block)), ABOUT)
    rows = np.flatnonzero(alone & ~doubled)
    side = ABOUT // 2 + 1
    before, after = np.maximum(rows - side, 0), np.minimum(rows + side, len(block) - 1)
    doubled[rows[level[after] - level[before] < -0.5]] = True
    return doubled


def _roughness(
    x: Float[np.ndarray, " rows"], q: Float[np.ndarray, "rows dof"]
) -> Float[np.ndarray, "inner dof"]:
    """Residual of each row from the cubic through the two rows before and the two after it."""
    count = len(x) - 4
    neighbours = (0, 1, 3, 4)
    nodes = np.column_stack([x[k : k + count] for k in neighbours])
    missed = q[2:-2].copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k, weight in zip(neighbours, weights_at(nodes, x[2:-2]).T, strict=True):
            missed -= weight[:, None] * q[k : k + count]
    return missed


def _revised(grid: Grid, q: Float[np.ndarray, "kept dof"]) -> Grid:
    """Grid with short holes at the rows that positions suggest, and without false holes.

    Args:
        q: positions at the kept rows.
    """
    lost, rows = grid.lost.copy(), len(grid.lost)
    near = int(np.clip(_REACH * spread(grid.off), _NEAR, _FARTHEST))
    side = near + SIDE
    faults = np.flatnonzero(lost)
    alone = np.diff(faults, prepend=-2 * side, append=rows + 2 * side) > side + near
    inside = (faults >= side) & (faults <= rows - side)
    for missing in range(1, _LONGEST + 1):
        at = faults[alone[:-1] & alone[1:] & inside & (lost[faults] == missing)]
        if not at.size:
            continue
        around = q[at[:, None] + np.arange(-side, side)]
        likely = _likelihood(around, missing, near)  # without a hole, then for each place
        best = likely.argmax(axis=1)
        gain = likely[np.arange(len(at)), best] - likely[:, 1 + near]
        # With a likelihood ratio above the number of rows, chance moves less than one hole.
        sure = gain > np.log(rows)
        lost[at[sure]] = 0
        moved = sure & (best > 0)
        lost[at[moved] + best[moved] - 1 - near] = missing
    return replace(grid, lost=lost)


def _likelihood(
    around: Float[np.ndarray, "holes rows dof"], missing: int, near: int
) -> Float[np.ndarray, "holes places"]:
    """Log-likelihoods without a hole, and with a hole before each row from −near to near."""
    side = near + SIDE
    x = np.arange(-side, side)
    places = [side, *range(-near, near + 1)]
    free = len(x) - DEGREE - 1
    y = around - around.mean(axis=1, keepdims=True)
    likely: list[np.ndarray] = []
    for row in places:
        basis = np.polynomial.legendre.legvander(
            (x + missing * (x >= row)) / (side + missing), DEGREE
        )
        q = np.linalg.qr(basis)[0]
        rest = y - q @ (q.T @ y)
        squares = np.einsum("hrd,hrd->hd", rest, rest)
        likely.append(-0.5 * free * np.log(squares + 1e-20).sum(axis=1))
    return np.stack(likely, axis=1)
