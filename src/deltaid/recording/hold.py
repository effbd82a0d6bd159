"""Torques that drives update now and then and hold between two updates.

A held torque is known at its updates only: rows in which it changes, and further ones where it has
not changed for longer than an update takes. Rows between are interpolated from the two updates
before and after, by a polynomial, so nothing comes late that was not.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from deltaid.recording.columns import Columns
from deltaid.recording.table import recut

# Updates that lie on one line in time, such groups at least, and the share of groups that do:
# repeated numbers that are due to a coarse unit come at irregular times.
_GROUP, _GROUPS, _MOST = 16, 6, 0.8
# A torque held for fewer rows is late by less than an eighth of one.
_SHORTEST = 1.25
# Updates on either side that a value is interpolated from; rows put right at once.
_HALF, _AT_ONCE = 2, 8000
# The row of an update before the first one that is observed.
_NEVER = -(1 << 60)

Rows = Float[np.ndarray, "_ _"]


def held_rows(stretches: Iterable[Iterable[Rows]], columns: Columns) -> tuple[float, ...]:
    """For how many rows each drive's torque is held; 0 where it is not.

    Args:
        stretches: of evenly spaced rows in blocks.
        columns: what stands where.
    """
    gaps = [list[np.ndarray]() for _ in columns.torque]
    for stretch in stretches:
        tau = np.concatenate([rows[:, columns.torque_places] for rows in stretch])
        for own, x in zip(gaps, tau.T, strict=True):
            updates = np.flatnonzero(np.diff(x) != 0)
            own.append(updates[: len(updates) // _GROUP * _GROUP].reshape(-1, _GROUP))
    return tuple(_period(np.concatenate(own)) if own else 0.0 for own in gaps)


def _period(updates: np.ndarray) -> float:
    """The period of updates in groups (groups, updates), if there is one [rows]."""
    if len(updates) < _GROUPS:
        return 0.0
    length = np.diff(updates[:, 0])
    usual = length[np.abs(length - np.median(length)) <= 1.0]
    period = float(np.mean(usual)) / _GROUP if usual.size else 0.0
    if period < _SHORTEST:
        return 0.0
    off = updates - period * np.arange(_GROUP)
    regular = np.ptp(off, axis=1) <= 1.0 + 1e-9
    return period if np.mean(regular) > _MOST else 0.0


def spread(rows: float) -> int:
    """Over how many rows to either side a torque is spread that is held for so many."""
    return _HALF * int(np.ceil(rows))


def filled(segment: Iterable[Rows], columns: Columns, hold: tuple[float, ...]) -> Iterator[Rows]:
    """Rows of a segment with torques interpolated between their updates, in constant memory.

    Nothing depends on how the rows are cut into blocks.

    Args:
        segment: evenly spaced rows in blocks: `columns`, then a weight a drive.
        columns: what stands where.
        hold: rows between two updates of each drive's torque; 0 for one that is not held.
    """
    margin, drives = max(map(spread, hold)) + 1, len(hold)
    marked = _padded(_marked(segment, columns, hold), margin, drives)
    for wide in recut(marked, _AT_ONCE, 2 * margin):
        out = wide[margin : len(wide) - margin, :-drives].copy()
        inner = np.arange(margin, len(wide) - margin)
        for i, rows in enumerate(hold):
            if rows:
                tau, weight = columns.torque_places.start + i, out.shape[1] - drives + i
                knots = np.flatnonzero(wide[:, i - drives] > 0)
                out[:, tau], least = _between(wide[:, tau], wide[:, weight], knots, inner)
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
    segment: Iterable[Rows], columns: Columns, hold: tuple[float, ...]
) -> Iterator[Rows]:
    """Rows with a further column a drive: 1 where its torque has been updated."""
    before, since = None, np.full(len(hold), _NEVER)
    longest = np.maximum(np.ceil(hold).astype(int), 1)
    for rows in segment:
        if not len(rows):
            continue
        tau = rows[:, columns.torque_places]
        before = tau[:1] if before is None else before
        changed = np.diff(tau, axis=0, prepend=before) != 0
        number = np.arange(len(rows))[:, None]
        last = np.maximum.accumulate(np.where(changed, number, since), axis=0)
        yield np.hstack([rows, ((number - last) % longest == 0) & (last > _NEVER // 2)])
        before, since = tau[-1:], np.where(last[-1] > _NEVER // 2, last[-1] - len(rows), _NEVER)


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
