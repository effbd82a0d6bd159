"""Converts times of loggers to seconds, and unwraps counters and angles.

Text of dates and times of day, and integer ticks, become seconds since the first row. Integers are
subtracted as integers, because nanoseconds since 1970 have more digits than a float64.

A step of nearly one period between samples whose neighbours move little is a wrap: of an encoder
with 16 bits after 65 536 counts, of an angle after one turn, or of a cycle counter with 8, 16, 24
or 32 bits.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl
from jaxtyping import Float, Int

from deltaid.errors import Doubt, counted
from deltaid.recording.columns import Columns, TimeChannel
from deltaid.recording.source import ColumnValues, LogTable, Rows

# A date such as 2025-11-20T16:00:00.123456789+01:00, with a blank or T, any number of digits, with
# or without a zone; or a time of day.
_ISO = (
    r"^(?:(?P<date>\d{4}-\d{2}-\d{2})[T ])?(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2})"
    r"(?:[.,](?P<fraction>\d{1,9})\d*)?"
    r"(?: ?(?:Z|UTC|(?P<sign>[+-])(?P<ahead>\d{2})(?::?(?P<past>\d{2}))?))?$"
)
# Units of time per second: of dates and durations, and longer ones; spreadsheets write dates in
# days.
PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3}
_LONGER = {"s": 1.0, "min": 1 / 60, "3600 s": 1 / 3600, "86400 s": 1 / 86400}
# Largest whole number up to which float64 is exact.
_EXACT = 2 / np.finfo(float).eps
# Largest difference of a wrap from the period, and of its neighbours from 0, as a share of the
# period.
_NEAR = 0.25
# Periods of counters of positions, and of cycles.
_OVERFLOWS = tuple(2.0**bits for bits in (16, 24, 32))
_CYCLES = (2.0**8, *_OVERFLOWS)


def unit_factors(time: TimeChannel) -> dict[str, float]:
    """Factors by which rates and speeds change if a column of times is in another unit than
    declared; the nearest unit first. Empty if the declared one is 0."""
    factors = {unit: per * time.scale for unit, per in (PER_SECOND | _LONGER).items()}
    usable = [pair for pair in factors.items() if 0 < pair[1] < math.inf]
    return dict(sorted(usable, key=lambda pair: abs(math.log(pair[1]))))


def is_clock(column: ColumnValues | None) -> bool:
    """Whether a column is text that begins with a date with time of day, or a time of day."""
    return (
        isinstance(column, pl.Series)
        and column.dtype == pl.String
        and column[:1].str.contains(_ISO).any()
    )


def in_seconds(pieces: Iterable[Rows]) -> Iterator[Rows]:
    """All rows of a log, with the time, which is the first column, in seconds."""
    origin: int | None = None
    for rows in pieces:
        if (ticks := _ticks(rows.numbers[0], rows.written[0])) is not None:
            first = ticks[0].drop_nulls()
            if origin is None:
                origin = int(first[0]) if len(first) else 0
            seconds = (ticks[0] - origin).cast(pl.Float64) / ticks[1]
            rows = replace(rows, numbers=[seconds, *rows.numbers[1:]])
        yield rows


def _ticks(numbers: ColumnValues, written: ColumnValues) -> tuple[pl.Series, float] | None:
    """Integer ticks and ticks per second; None for numbers that float64 holds exactly."""
    if isinstance(numbers, np.ndarray) and numbers.dtype.kind in "iuM":
        numbers = pl.Series(numbers.astype("M8[ns]") if numbers.dtype.kind == "M" else numbers)
    if isinstance(numbers, pl.Series) and numbers.dtype.base_type() in (pl.Datetime, pl.Time):
        unit = getattr(numbers.dtype, "time_unit", "ns")
        return numbers.to_physical(), PER_SECOND[unit]
    if isinstance(written, pl.Series) and written.dtype == pl.String and len(written):
        if is_clock(written):
            return _nanoseconds(written), PER_SECOND["ns"]
        # Text with this many digits is exact as an integer only.
        exact = written.str.contains(r"^\d{16,19}$").all()
        return (written.cast(pl.Int64, strict=False), 1.0) if exact else None
    if isinstance(numbers, pl.Series) and numbers.dtype.is_integer():
        ends = (abs(int(str(end or 0))) for end in (numbers.min(), numbers.max()))
        return (numbers.cast(pl.Int64, strict=False), 1.0) if max(ends) >= _EXACT else None
    return None


def _nanoseconds(texts: pl.Series) -> pl.Series:
    """Dates and times of day as nanoseconds since 1970; null for other text."""
    parts = texts.str.extract_groups(_ISO).struct.unnest()

    def whole(name: str) -> pl.Series:
        return parts[name].cast(pl.Int64, strict=False)

    days = parts["date"].str.to_date("%Y-%m-%d", strict=False).to_physical().cast(pl.Int64)
    days = days.set(parts["date"].is_null() & days.is_null(), 0)
    fraction = parts["fraction"].fill_null("0").str.pad_end(9, "0").cast(pl.Int64, strict=False)
    seconds = ((days * 24 + whole("hour")) * 60 + whole("minute")) * 60 + whole("second")
    ahead = (whole("ahead").fill_null(0) * 60 + whole("past").fill_null(0)) * 60
    sign = 1 - 2 * (parts["sign"] == "-").fill_null(False).cast(pl.Int64)
    return (seconds - sign * ahead) * 10**9 + fraction


@dataclass
class Unwrapper:
    """Running unwrapping of one column.

    Attributes:
        name: name of the column.
        periods: possible periods.
        overflows: further possible periods if all numbers are whole.
        rising: whether the column only counts up.
        period: period of the first wrap, which holds for all; 0 before it.
        offset: sum of the wraps so far.
        count, first: number of wraps, and row of the first one.
    """

    name: str
    periods: tuple[float, ...]
    overflows: tuple[float, ...]
    rising: bool = False
    period: float = 0.0
    offset: float = 0.0
    count: int = 0
    first: int = 0
    _last: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def add(self, numbers: Float[np.ndarray, " rows"], row: int) -> Float[np.ndarray, " rows"]:
        """Unwrap consecutive numbers; `row` is the row of the first one."""
        known, start = np.concatenate([self._last, numbers]), len(self._last)
        self._last, rounds = known[-2:], self._rounds(known)
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
        """Rows of wraps, negative for wraps downwards."""
        steps = np.diff(x)
        smallest = self.period or min((*self.periods, *self.overflows))
        far = np.flatnonzero(np.abs(steps) > (1 - _NEAR) * smallest)
        if self.rising:
            far = far[steps[far] < 0]
        if not far.size:
            return far
        whole = bool(np.all(x == np.round(x)))
        possible = (*self.periods, *(self.overflows if whole else ()))
        periods = (self.period,) if self.period else possible
        for period in sorted(periods, key=lambda p: np.abs(np.abs(steps[far]) - p).min()):
            wraps = far[_is_round(x, steps, far, period)]
            if wraps.size:
                self.period = period
                return np.where(steps[wraps] < 0, 1, -1) * (wraps + 1)
        return far[:0]


def _is_round(
    x: Float[np.ndarray, " rows"],
    steps: Float[np.ndarray, " steps"],
    at: Int[np.ndarray, " far"],
    period: float,
) -> np.ndarray:
    near = np.abs(np.abs(steps[at]) - period) < _NEAR * period
    for neighbour in (at - 1, at + 1):
        inside = (neighbour >= 0) & (neighbour < len(steps))
        small = np.abs(steps[np.clip(neighbour, 0, len(steps) - 1)]) < _NEAR * period
        near &= small | ~inside
    room = 0.01 * period
    for end in (x[at], x[at + 1]):
        near &= (end > -0.5 * period - room) & (end < period + room)
    return near


def unwrappers(columns: Columns) -> list[Unwrapper]:
    """Unwrappers of time and positions, in the order of `Columns.all`; others do not wrap."""
    turning = (Unwrapper(c.column, (c.turn,) * bool(c.turn), _OVERFLOWS) for c in columns.position)
    return [Unwrapper(columns.time.column, (), _CYCLES, rising=True), *turning]


def doubts_about_rounds(columns: Iterable[Unwrapper], table: LogTable) -> list[Doubt]:
    return [
        Doubt(
            f"column {column.name} starts again after {_numbers(column.period)} in "
            f"{counted(column.count, 'row')}, the first "
            f"{table.row_name(column.first)}: taken to go on",
            cause="a counter that is full begins anew"
            if _is_counter(column.period)
            else "the controller keeps angles within one turn",
            cure="no action is needed, unless it was set anew there: then split the log",
        )
        for column in columns
        if column.count
    ]


def _is_counter(period: float) -> bool:
    bits = np.log2(period)
    return bool(bits == round(bits) and period >= _CYCLES[0])


def _numbers(period: float) -> str:
    if _is_counter(period):
        return f"{period:.0f} counts ({np.log2(period):.0f} bits)"
    return f"{period:.6g}, one turn,"
