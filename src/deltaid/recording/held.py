"""Whether drives hold their torques between two updates, and for how many rows.

Where nothing is added to a held torque, it repeats exactly, and rows that change lie on a line:
repeated numbers that are due to a coarse unit come at irregular times. Where a log adds noise to
each row, a torque held for k rows rises in every k-th row only. With the rise d of a torque from
row to row and its slope s about it, by other rows, d is regressed on s for rows of each phase,

    d_n = c_r s_n,    r = n mod k,

and all c_r but that of updates are zero; without a hold they are equal.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from deltaid.recording.columns import Columns
from deltaid.recording.hold import Hold, row_numbers

# Updates that lie on one line in time, such groups at least, and the share of groups that do.
_GROUP, _GROUPS, _MOST = 16, 6, 0.8
# A torque held for fewer rows is late by less than an eighth of one.
_SHORTEST = 1.25
# Longest hold of a log with noise [s]; prime factors of its rows, one of which shows any.
_LONGEST, _PRIMES = 0.012, (2, 3, 5, 7, 11, 13, 17, 19, 23)
# How often recordings without a hold are said to have one; standard deviations, and the share of
# an update's rise, that those of other rows surely stay below.
_SEEN, _SURE, _LEFT = 1e-6, 3.0, 0.5

# Share of rows that have no step of friction near, and of rises of a phase that no jump made.
_USUAL = 0.9
# Parts of a recording that have to agree.
_PARTS = 2

Rows = Float[np.ndarray, "_ _"]
Stretch = tuple[np.ndarray, np.ndarray]  # numbers of rows, and a drive's torque


def holds(stretches: Iterable[Iterable[Rows]], columns: Columns, rate: float) -> tuple[Hold, ...]:
    """How each drive holds its torque.

    Args:
        stretches: of evenly spaced rows in blocks.
        columns: what stands where.
        rate: rows per second.
    """
    parts = [np.concatenate(list(stretch)) for stretch in stretches]
    numbers = [row_numbers(part, rate) for part in parts]
    found = list[Hold]()
    for place in range(columns.torque_places.start, columns.torque_places.stop):
        tau = [part[:, place] for part in parts]
        rows = _repeated(tau)
        pairs = list(zip(numbers, tau, strict=True))
        found.append(Hold(rows) if rows else _rising(pairs, round(_LONGEST * rate)))
    return tuple(found)


def _repeated(stretches: Sequence[np.ndarray]) -> float:
    """Rows between two changes, where these are regular."""
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


def _rising(stretches: Sequence[Stretch], longest: int) -> Hold:
    """The longest hold by which torques rise in updates only."""
    primes = [k for k in _PRIMES if k <= longest]
    first = [k for k in primes if _phase(stretches, k) is not None]
    for k in range(longest, 1, -1) if first else ():
        if any(k % prime == 0 for prime in first) and (phase := _phase(stretches, k)) is not None:
            return Hold(float(k), phase)
    return Hold(0.0)


def _phase(stretches: Sequence[Stretch], k: int) -> int | None:
    """The phase of the updates of a torque that is held for k rows; None where it is not.

    All parts of a recording show the same, which steps of friction at some rows do not.
    """
    phases = {_phase_of(part, k) for part in _parts(stretches)}
    return phases.pop() if len(phases) == 1 else None


def _parts(stretches: Sequence[Stretch]) -> list[list[Stretch]]:
    """Every stretch in as many parts of equal length."""
    split = [
        list(zip(np.array_split(n, _PARTS), np.array_split(tau, _PARTS), strict=True))
        for n, tau in stretches
    ]
    return [list(part) for part in zip(*split, strict=True)]


def _limit(rises: np.ndarray, phases: np.ndarray, k: int) -> float:
    """What most rises of every phase stay below: a few jumps that share a phase are no updates."""
    own = (np.abs(rises[phases == phase]) for phase in range(k))
    return max(float(np.quantile(rise, _USUAL)) for rise in own if rise.size)


def _phase_of(stretches: Sequence[Stretch], k: int) -> int | None:
    """The same of one part."""
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
        usual = np.abs(d) <= _limit(d, r, k)
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
    others = np.delete(np.abs(c) + _SURE * np.sqrt(variance), update)
    if chi2.sf(distance, k - 1) > _SEEN ** (1 / _PARTS) or np.any(others > _LEFT * c[update]):
        return None
    return update
