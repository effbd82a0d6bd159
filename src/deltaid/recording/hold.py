"""Torques that drives update now and then and hold between two updates: interpolated between these.

A held torque is known at its updates only: rows in which it changes, and further ones where it has
not changed for longer than an update takes. Where a log adds noise to each row, these are every
so-manieth row, and noise of the rows between averages out (`held` detects both). All rows are
interpolated from the two updates before and after, so nothing comes late that was not.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.recording.columns import Columns
from deltaid.recording.table import recut

# Updates on either side that a value is interpolated from; rows put right at once.
_HALF, _AT_ONCE = 2, 8000
# The row of an update before the first one that is observed.
_NEVER = -(1 << 60)

Rows = Float[np.ndarray, "_ _"]


@dataclass(frozen=True)
class Hold:
    """How a drive holds its torque.

    Attributes:
        rows: between two updates; 0 where it is not held.
        phase: number of an update's row, counted from time 0 on, modulo `rows`; None where rows
            that change are updates.
    """

    rows: float
    phase: int | None = None

    @property
    def spread(self) -> int:
        """Over how many rows to either side a torque is spread."""
        return _HALF * int(np.ceil(self.rows))

    def __bool__(self) -> bool:
        return self.rows > 0


def filled(
    segment: Iterable[Rows], columns: Columns, hold: tuple[Hold, ...], rate: float
) -> Iterator[Rows]:
    """Rows of a segment with torques interpolated between their updates, in constant memory.

    Nothing depends on how the rows are cut into blocks.

    Args:
        segment: evenly spaced rows in blocks: `columns`, then a weight a drive.
        columns: what stands where.
        hold: of each drive.
        rate: rows per second.
    """
    margin, drives = 2 * max(one.spread for one in hold) + 1, len(hold)
    marked = _padded(_marked(segment, columns, hold, rate), margin, drives)
    for wide in recut(marked, _AT_ONCE, 2 * margin):
        out = wide[margin : len(wide) - margin, :-drives].copy()
        inner = np.arange(margin, len(wide) - margin)
        for i, one in enumerate(hold):
            if one:
                place, weight = columns.torque_places.start + i, out.shape[1] - drives + i
                knots, tau = np.flatnonzero(wide[:, i - drives] > 0), wide[:, place]
                if one.phase is not None:  # means of an update's rows
                    sums = np.append(0.0, np.cumsum(tau))
                    ends = np.minimum(np.arange(len(tau)) + round(one.rows), len(tau))
                    tau = (sums[ends] - sums[:-1]) / (ends - np.arange(len(tau)))
                out[:, place], least = _between(tau, wide[:, weight], knots, inner)
                out[:, weight] = np.minimum(out[:, weight], least)
        yield out


def _between(
    tau: np.ndarray, weight: np.ndarray, knots: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values at rows by those of knots about them, and the least weight of these."""
    first = np.searchsorted(knots, rows, side="right") - _HALF
    inside = (first >= 0) & (first + 2 * _HALF <= len(knots))
    value, least = tau[rows], np.where(inside, weight[rows], 0.0)
    own = knots[first[inside, None] + np.arange(2 * _HALF)]
    s = rows[inside, None] - own.astype(float)
    shares = np.ones(own.shape)
    for k in range(2 * _HALF):
        for m in range(2 * _HALF):
            if m != k:
                shares[:, k] *= s[:, m] / (own[:, k] - own[:, m])
    value[inside] = np.sum(shares * tau[own], axis=1)
    used = np.where(shares != 0.0, weight[own], np.inf)
    least[inside] = np.min(used, axis=1)
    return value, least


def _marked(
    segment: Iterable[Rows], columns: Columns, hold: tuple[Hold, ...], rate: float
) -> Iterator[Rows]:
    """Rows with a further column a drive: 1 where its torque has been updated."""
    before, since = None, np.full(len(hold), _NEVER)
    longest = np.array([max(1, int(np.ceil(one.rows))) for one in hold])
    for rows in segment:
        if not len(rows):
            continue
        tau = rows[:, columns.torque_places]
        before = tau[:1] if before is None else before
        changed = np.diff(tau, axis=0, prepend=before) != 0
        number = np.arange(len(rows))[:, None]
        last = np.maximum.accumulate(np.where(changed, number, since), axis=0)
        marks = ((number - last) % longest == 0) & (last > _NEVER // 2)
        for i, one in enumerate(hold):
            if one.phase is not None:
                marks[:, i] = row_numbers(rows, rate) % round(one.rows) == one.phase
        yield np.hstack([rows, marks])
        before, since = tau[-1:], np.where(last[-1] > _NEVER // 2, last[-1] - len(rows), _NEVER)


def row_numbers(rows: Rows, rate: float) -> Int[np.ndarray, " _"]:
    """Numbers of rows counted from time 0 on."""
    return np.round(np.nan_to_num(rows[:, 0]) * rate).astype(int)


def _padded(segment: Iterable[Rows], margin: int, drives: int) -> Iterator[Rows]:
    """A segment with rows beyond its ends that are no updates."""
    last: Rows | None = None
    for rows in segment:
        if last is None:
            yield _beyond(rows[:1], margin, drives)
        last = rows
        yield rows
    if last is not None:
        yield _beyond(last[-1:], margin, drives)


def _beyond(row: Rows, count: int, drives: int) -> Rows:
    rows = np.repeat(row, count, axis=0)
    rows[:, -drives:] = 0.0
    return rows
