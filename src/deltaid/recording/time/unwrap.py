"""Counters that overflow and angles that start again, made to go on.

A step of nearly one whole period between two samples whose neighbours move by a small part of it
is the start of a new round: an encoder of 16 bits after 65 536 counts, an angle after one turn, a
cycle counter of 8, 16, 24 or 32 bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import Doubt
from deltaid.recording.columns import Columns
from deltaid.recording.source import Table

# A step counts as a new round if it misses the period by less than this share, and so do its
# neighbours from rest.
_NEAR = 0.25
# Counts after which counters start again.
_OVERFLOWS = tuple(2.0**bits for bits in (16, 24, 32))
_CYCLES = (2.0**8, *_OVERFLOWS)


@dataclass
class Unwrapper:
    """One column on its way: how far it has gone on.

    Attributes:
        periods: in the column's numbers, that it may have.
        overflows: that it may have if all its numbers are whole.
        rising: whether it only counts up.
        period: the one found; 0 as long as there is none.
        offset: what has been added up.
        count, first: how many new rounds there are, and the row of the first.
    """

    periods: tuple[float, ...]
    overflows: tuple[float, ...]
    rising: bool = False
    period: float = 0.0
    offset: float = 0.0
    count: int = 0
    first: int = 0
    _last: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def add(self, numbers: Float[np.ndarray, " rows"], row: int) -> Float[np.ndarray, " rows"]:
        """Consecutive numbers, which go on; `row` numbers the first."""
        known = np.concatenate([self._last, numbers])
        start = len(self._last)
        self._last = known[-2:]
        rounds = self._rounds(known)
        rounds = rounds[np.abs(rounds) >= max(start, 1)] if start else rounds
        if not rounds.size:
            return numbers + self.offset if self.offset else numbers
        if not self.count:
            self.first = row + int(abs(rounds[0])) - start
        self.count += len(rounds)
        added = np.zeros(len(known))
        added[np.abs(rounds)] = np.sign(rounds) * self.period
        total = self.offset + np.cumsum(added[start:])
        self.offset = float(total[-1])
        return numbers + total

    def _rounds(self, x: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " rounds"]:
        """Rows where a new round starts, negative where it goes down."""
        steps = np.diff(x)
        smallest = self.period or min((*self.periods, *self.overflows))
        far = np.flatnonzero(np.abs(steps) > (1 - _NEAR) * smallest)
        if self.rising:
            far = far[steps[far] < 0]
        if not far.size:
            return far
        periods = (self.period,) if self.period else self._possible(x)
        for period in sorted(periods, key=lambda p: np.abs(np.abs(steps[far]) - p).min()):
            found = far[_is_round(x, steps, far, period)]
            if found.size:
                self.period = period
                return np.where(steps[found] < 0, 1, -1) * (found + 1)
        return far[:0]

    def _possible(self, x: Float[np.ndarray, " rows"]) -> tuple[float, ...]:
        whole = bool(np.all(x == np.round(x)))
        return (*self.periods, *(self.overflows if whole else ()))


def _is_round(
    x: Float[np.ndarray, " rows"],
    steps: Float[np.ndarray, " steps"],
    at: Int[np.ndarray, " far"],
    period: float,
) -> np.ndarray:
    """Whether steps are new rounds of some period."""
    near = np.abs(np.abs(steps[at]) - period) < _NEAR * period
    for beside in (at - 1, at + 1):
        inside = (beside >= 0) & (beside < len(steps))
        small = np.abs(steps[np.clip(beside, 0, len(steps) - 1)]) < _NEAR * period
        near &= small | ~inside
    room = 0.01 * period
    for end in (x[at], x[at + 1]):
        near &= (end > -0.5 * period - room) & (end < period + room)
    return near


class Unwrapping:
    """Time and positions of a log on their way."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._time = Unwrapper((), _CYCLES, rising=True)
        self._positions = [
            Unwrapper((channel.turn,) if channel.turn else (), _OVERFLOWS)
            for channel in columns.position
        ]

    def unwrapper(self, channel: int) -> Unwrapper | None:
        """What a channel of `Columns.all` takes; None if it never starts again."""
        if not channel:
            return self._time
        return self._positions[channel - 1] if channel <= len(self._positions) else None

    def doubts(self, table: Table) -> list[Doubt]:
        """Columns that were made to go on."""
        names = [channel.column for channel in self._columns.all]
        found: Sequence[Unwrapper] = (self._time, *self._positions)
        return [
            Doubt(
                f"column {name} starts again after {_numbers(unwrapper.period)} in "
                f"{unwrapper.count} row{'s' if unwrapper.count > 1 else ''}, the first "
                f"{table.row_name(unwrapper.first)}: taken to go on",
                cause=_why(unwrapper.period),
                cure="nothing is to be done, unless it was set anew there: then split the log",
            )
            for name, unwrapper in zip(names, found, strict=False)
            if unwrapper.count
        ]


def _is_counter(period: float) -> bool:
    bits = np.log2(period)
    return bool(bits == round(bits) and period >= _CYCLES[0])


def _why(period: float) -> str:
    if _is_counter(period):
        return "a counter that is full begins anew"
    return "the controller keeps angles within one turn"


def _numbers(period: float) -> str:
    """A period in the column's numbers."""
    if _is_counter(period):
        return f"{period:.0f} counts ({np.log2(period):.0f} bits)"
    return f"{period:.6g}, one turn,"
