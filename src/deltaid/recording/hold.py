"""Detects torques that drives update at a lower rate and hold in between, and interpolates them.

A held torque is known at its updates only: in rows in which it changes, or in which an update is
due. If the log adds noise to each row, updates are every k-th row, and the noise of the held rows
averages out (`holds` detects both). All rows are interpolated from the two updates before and the
two after, which adds no delay.

Without added noise, a held torque repeats exactly and changes at regular times; repetitions due to
a coarse unit are irregular. With added noise, a torque held for k rows rises in every k-th row
only. For the rows of each phase r, the rise d of a torque from row to row is regressed on its slope
s, which other rows determine:

    d_n = c_r s_n,    r = n mod k.

With a hold, all c_r but that of the updates are zero; without a hold, all are equal.

A logger may instead draw straight lines between updates, which it knows only afterwards. Then the
torque bends, τ_{n+1} − 2 τ_n + τ_{n−1} ≠ 0, in the rows of one phase only.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.stats import chi2

from deltaid.levels import NEVER, SURE
from deltaid.recording.columns import Columns, Rows
from deltaid.recording.delay import TORQUE_SIDE
from deltaid.recording.table import padded, recut
from deltaid.recording.time.signals import weights_at
from deltaid.recording.windows import WINDOW

# Updates per group, fewest groups, and least share of groups with regular updates.
_GROUP, _GROUPS, _MOST = 16, 6, 0.8
# Shortest hold [rows]: a shorter one delays the torque by less than an eighth of a row.
_SHORTEST = 1.25
# Longest hold that is searched in a log with noise [s], and prime factors of its number of rows.
_LONGEST, _PRIMES = 0.012, (2, 3, 5, 7, 11, 13, 17, 19, 23)
# Share of rows without a step of friction, and of the rises of a phase without a jump.
_USUAL = 0.9
# Largest bend between updates, as a share of that at updates, which the log's digits make.
_BENDS = 0.1

HeldTorque = tuple[np.ndarray, np.ndarray]  # row numbers, and a drive's torque in these rows


@dataclass(frozen=True)
class Hold:
    """Hold of a drive's torque between updates.

    Attributes:
        rows: number of rows from one update to the next; 0 if the torque is not held.
        phase: row of an update, counted from time 0, modulo `rows`; None if updates are the rows
            in which the torque changes.
        is_straight: whether the torque is on straight lines between updates.
    """

    rows: float
    phase: int | None = None
    is_straight: bool = False

    @property
    def spread(self) -> int:
        """Rows to either side over which a torque is interpolated."""
        return TORQUE_SIDE * int(np.ceil(self.rows))

    def __bool__(self) -> bool:
        return self.rows > 0


def filled(
    segment: Iterable[Rows], columns: Columns, hold: tuple[Hold, ...], rate: float
) -> Iterator[Rows]:
    """Rows of a segment with torques interpolated between their updates, in constant memory.

    The result does not depend on the blocks.

    Args:
        segment: evenly spaced rows in blocks: `columns`, then one weight per drive.
        columns: columns of the rows.
        hold: hold of each drive's torque.
        rate: rows per second.
    """
    margin, drives = 2 * max(held.spread for held in hold) + 1, len(hold)
    marked = padded(_with_marks(segment, columns, hold, rate), margin, margin, columns)
    for wide in recut(marked, WINDOW, 2 * margin):
        out = wide[margin : len(wide) - margin, :-drives].copy()
        inner = np.arange(margin, len(wide) - margin)
        for i, held in enumerate(hold):
            if held:
                place, weight = columns.torque_places.start + i, out.shape[1] - drives + i
                knots, tau = np.flatnonzero(wide[:, i - drives] > 0), wide[:, place]
                if held.phase is not None and not held.is_straight:  # mean of an update's rows
                    sums = np.append(0.0, np.cumsum(tau))
                    ends = np.minimum(np.arange(len(tau)) + round(held.rows), len(tau))
                    tau = (sums[ends] - sums[:-1]) / (ends - np.arange(len(tau)))
                out[:, place], least = _interpolated(tau, wide[:, weight], knots, inner)
                out[:, weight] = np.minimum(out[:, weight], least)
        yield out


def _interpolated(
    tau: np.ndarray, weight: np.ndarray, knots: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values that are interpolated at rows from knots, and the least weight of the knots used."""
    first = np.searchsorted(knots, rows, side="right") - TORQUE_SIDE
    inside = (first >= 0) & (first + 2 * TORQUE_SIDE <= len(knots))
    value, least = tau[rows], np.where(inside, weight[rows], 0.0)
    updates = knots[first[inside, None] + np.arange(2 * TORQUE_SIDE)]
    shares = weights_at(updates.astype(float), rows[inside].astype(float))
    value[inside] = np.sum(shares * tau[updates], axis=1)
    used = np.where(shares != 0.0, weight[updates], np.inf)
    least[inside] = np.min(used, axis=1)
    return value, least


def _with_marks(
    segment: Iterable[Rows], columns: Columns, hold: tuple[Hold, ...], rate: float
) -> Iterator[Rows]:
    """Rows with one more column per drive: 1 where its torque is updated."""
    before, since = None, np.full(len(hold), np.nan)  # NaN before the first update
    longest = np.array([max(1, int(np.ceil(held.rows))) for held in hold])
    for rows in segment:
        if not len(rows):
            continue
        tau = rows[:, columns.torque_places]
        before = tau[:1] if before is None else before
        changed = np.diff(tau, axis=0, prepend=before) != 0
        number = np.arange(len(rows))[:, None]
        last = np.fmax.accumulate(np.where(changed, number, since), axis=0)
        marks = (number - last) % longest == 0
        for i, held in enumerate(hold):
            if held.phase is not None:
                marks[:, i] = row_numbers(rows, rate) % round(held.rows) == held.phase
        yield np.hstack([rows, marks])
        before, since = tau[-1:], last[-1] - len(rows)


def row_numbers(rows: Rows, rate: float) -> Int[np.ndarray, " _"]:
    return np.round(np.nan_to_num(rows[:, 0]) * rate).astype(int)


def holds(stretches: Iterable[Iterable[Rows]], columns: Columns, rate: float) -> tuple[Hold, ...]:
    """Detect how each drive holds its torque.

    Args:
        stretches: evenly spaced rows of each stretch, in blocks.
        columns: columns of the rows.
        rate: rows per second.
    """
    parts = [np.concatenate(list(stretch)) for stretch in stretches]
    numbers = [row_numbers(part, rate) for part in parts]
    by_drive, longest = list[Hold](), round(_LONGEST * rate)
    for place in range(columns.torque_places.start, columns.torque_places.stop):
        tau = [part[:, place] for part in parts]
        rows = _exact_period(tau)
        pairs = zip(numbers, tau, strict=True)
        split = [[np.array_split(x, 2) for x in pair] for pair in pairs]
        halves = [[(n[k], y[k]) for n, y in split] for k in range(2)]
        hold = Hold(rows) or _straight_lines(numbers, tau, longest) or _noisy_hold(halves, longest)
        by_drive.append(hold)
    return tuple(by_drive)


def _exact_period(stretches: Sequence[np.ndarray]) -> float:
    """Mean number of rows between two changes; 0 if changes are irregular."""
    groups = list[np.ndarray]()
    for tau in stretches:
        updates = np.flatnonzero(np.diff(tau) != 0)
        groups.append(updates[: len(updates) // _GROUP * _GROUP].reshape(-1, _GROUP))
    updates = np.concatenate(groups)
    if len(updates) < _GROUPS:
        return 0.0
    length = np.diff(updates[:, 0])
    usual = length[np.abs(length - np.median(length)) <= 1.0]
    period = float(np.mean(usual)) / _GROUP if usual.size else 0.0
    if period < _SHORTEST:
        return 0.0
    regular = np.ptp(updates - period * np.arange(_GROUP), axis=1) <= 1.0 + 1e-9
    return period if np.mean(regular) > _MOST else 0.0


def _straight_lines(
    numbers: Sequence[np.ndarray], stretches: Sequence[np.ndarray], longest: int
) -> Hold:
    """Longest time between updates for which the torque bends at these only."""
    row = np.concatenate([number[1:-1] for number in numbers])
    bends = np.concatenate([np.abs(np.diff(tau, 2)) for tau in stretches])
    # At least half of the rows are between updates.
    few, most = np.quantile(bends, (0.5 * _USUAL, _USUAL)) if bends.size else (1.0, 1.0)
    if few > _BENDS * most:
        return Hold(0.0)
    for k in range(min(longest, len(bends) // _GROUP), 1, -1):
        usual = [np.quantile(bends[row % k == phase], _USUAL) for phase in range(k)]
        update = int(np.argmax(usual))
        at_updates = np.median(bends[row % k == update])
        if np.delete(usual, update).max() < _BENDS * at_updates:
            return Hold(float(k), update, is_straight=True)
    return Hold(0.0)


def _noisy_hold(parts: Sequence[Sequence[HeldTorque]], longest: int) -> Hold:
    """Longest hold for which torques rise at updates only."""
    primes = [k for k in _PRIMES if k <= longest]
    first = [k for k in primes if _phase(parts, k) is not None]
    for k in range(longest, 1, -1) if first else ():
        if any(k % prime == 0 for prime in first) and (phase := _phase(parts, k)) is not None:
            return Hold(float(k), phase)
    return Hold(0.0)


def _phase(parts: Sequence[Sequence[HeldTorque]], k: int) -> int | None:
    """Phase of the updates of a torque that is held for k rows; None if it is not.

    Both halves of a recording must have the same phase; steps of friction do not have one.
    """
    phases = {_phase_of(part, k) for part in parts}
    return phases.pop() if len(phases) == 1 else None


def _phase_of(stretches: Sequence[HeldTorque], k: int) -> int | None:
    products, squares = np.zeros(k), np.zeros(k)
    rises, count = 0.0, 0
    for numbers, tau in stretches:
        if len(tau) <= 4 * k:
            continue
        sums = np.append(0.0, np.cumsum(tau))
        means = (sums[k:] - sums[:-k]) / k
        n = np.arange(2 * k, len(tau) - 2 * k + 1)
        s = (means[n + k] - means[n - 2 * k]) / (3 * k)
        d = tau[n] - tau[n - 1]
        usual = np.abs(s) <= np.quantile(np.abs(s), _USUAL)
        d, s, r = d[usual], s[usual], numbers[n[usual]] % k
        # Limit the rises of all phases, so that a few jumps of one phase do not look like updates.
        most = max(float(np.quantile(np.abs(d[r == phase]), _USUAL)) for phase in np.unique(r))
        usual = np.abs(d) <= most
        d, s, r = d[usual], s[usual], r[usual]
        products += np.bincount(r, d * s, k)
        squares += np.bincount(r, s**2, k)
        rises, count = rises + float(d @ d), count + len(d)
    if rises == 0 or np.any(squares == 0):
        return None
    c, variance = products / squares, rises / count / squares
    common = float(np.sum(c / variance) / np.sum(1 / variance))
    distance = float(np.sum((c - common) ** 2 / variance))
    update = int(np.argmax(c))
    others = np.delete(np.abs(c) + SURE * np.sqrt(variance), update)
    if chi2.sf(distance, k - 1) > NEVER**0.5 or np.any(others > 0.5 * c[update]):
        return None
    return update
