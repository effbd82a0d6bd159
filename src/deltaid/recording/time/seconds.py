"""Times as loggers write them: dates and times of day as text, whole ticks of any size, cycles.

Whole numbers are subtracted as whole numbers: seconds since 1970 in nanoseconds have more digits
than a float64.
"""

from dataclasses import replace

import numpy as np
import polars as pl

from deltaid.recording.source import Column, Rows

# 2025-11-20T16:00:00.123456789+01:00, with blank or T, any number of digits, with zone or without;
# a time of day alone.
_ISO = (
    r"^(?:(?P<date>\d{4}-\d{2}-\d{2})[T ])?(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2})"
    r"(?:[.,](?P<fraction>\d{1,9})\d*)?(?: ?(?P<zone>Z|UTC|[+-]\d{2}(?::?\d{2})?))?$"
)
# Nanoseconds in a second.
_NANO = 10**9
# Whole numbers beyond this are no longer exact as float64.
_EXACT = 2**53


def is_clock(text: str | None) -> bool:
    """Whether a field is a date with time of day, or a time of day."""
    return bool(text) and not pl.Series([text]).str.contains(_ISO).not_().any()


class Seconds:
    """The time column of one reading of a log, from its first row on."""

    def __init__(self) -> None:
        self._origin: int | None = None

    def numbers(self, rows: Rows) -> Rows:
        """The same rows with numbers for time, the first of their columns."""
        found = self._numbers(rows.numbers[0], rows.written[0])
        if found is rows.numbers[0]:
            return rows
        return replace(rows, numbers=[found, *rows.numbers[1:]])

    def _numbers(self, numbers: Column, written: Column) -> Column:
        if isinstance(written, pl.Series) and written.dtype == pl.String and len(written):
            if is_clock(written[0]):
                return self._since(_nanoseconds(written), 1 / _NANO)
            # Text with so many digits is exact as a whole number only.
            if written.str.contains(r"^\d{16,19}$").all():
                return self._since(written.cast(pl.Int64, strict=False), 1.0)
            return numbers
        ticks = numbers
        if isinstance(ticks, np.ndarray) and ticks.dtype.kind in "iu":
            ticks = pl.Series(ticks)
        if isinstance(ticks, pl.Series) and ticks.dtype.is_integer() and _is_large(ticks):
            return self._since(ticks.cast(pl.Int64, strict=False), 1.0)
        return numbers

    def _since(self, ticks: pl.Series, size: float) -> pl.Series:
        """Whole ticks since the first row, times their size."""
        if self._origin is None:
            first = ticks.drop_nulls()
            self._origin = int(first[0]) if len(first) else 0
        return (ticks - self._origin).cast(pl.Float64) * size


def _is_large(ticks: pl.Series) -> bool:
    return max(abs(int(str(end or 0))) for end in (ticks.min(), ticks.max())) >= _EXACT


def _nanoseconds(texts: pl.Series) -> pl.Series:
    """Dates and times of day as whole nanoseconds since 1970, null where a text is neither."""
    parts = texts.str.extract_groups(_ISO).struct.unnest()

    def whole(name: str) -> pl.Series:
        return parts[name].cast(pl.Int64, strict=False)

    days = parts["date"].str.to_date("%Y-%m-%d", strict=False).to_physical().cast(pl.Int64)
    undated = parts["date"].is_null()
    days = days.set(undated & days.is_null(), 0)
    fraction = parts["fraction"].fill_null("0").str.pad_end(9, "0").cast(pl.Int64, strict=False)
    seconds = ((days * 24 + whole("hour")) * 60 + whole("minute")) * 60 + whole("second")
    return (seconds - _offset(parts["zone"])) * _NANO + fraction


def _offset(zones: pl.Series) -> pl.Series:
    """Seconds by which zones are ahead of UTC; 0 without a zone."""
    parts = zones.str.extract_groups(r"([+-])(\d{2}):?(\d{2})?").struct.unnest()
    hours, minutes = (
        parts[name].cast(pl.Int64, strict=False).fill_null(0) for name in parts.columns[1:]
    )
    ahead = (hours * 60 + minutes) * 60
    sign = np.where((parts[parts.columns[0]] == "-").fill_null(False).to_numpy(), -1, 1)
    return ahead * pl.Series(sign)
