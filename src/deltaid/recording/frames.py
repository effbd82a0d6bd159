"""Columns of polars as numbers: lists, structs, dates, times as text, decimals."""

from collections.abc import Iterator, Sequence
from typing import Any

import polars as pl

from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.source import Rows
from deltaid.recording.time.seconds import is_clock

# One of polars; the run-time check of types cannot read the name of its class.
_DataType = Any
# Ticks a second of the units of dates.
_PER_SECOND = {"ns": 1e9, "us": 1e6, "ms": 1e3}


def fields_of(frame: pl.LazyFrame) -> tuple[RecordedField, ...]:
    """What a table holds; entries of structs under names of their own, such as `pose.x`.

    Reads one row, for the lengths of lists, and for text that is a time.
    """
    schema = frame.collect_schema()
    looked = [name for name, kind in schema.items() if _needs_a_look(kind)]
    first = frame.select(looked).head(1).collect() if looked else pl.DataFrame()
    return tuple(
        field
        for name, kind in schema.items()
        for field in _fields(name, kind, first[name] if name in looked else None)
    )


def tops(columns: Sequence[str], picks: Sequence[Pick]) -> list[str]:
    """The columns of a table that hold these fields."""
    return list(dict.fromkeys(_top(columns, pick.field.name) for pick in picks))


def rows_of(part: pl.DataFrame, picks: Sequence[Pick], origins: dict[str, int]) -> Rows:
    """Columns of consecutive rows, null where there is no number.

    Args:
        part: the rows.
        picks: which columns.
        origins: the first date of each column, which is set by the first rows.
    """
    written = [_written(part, pick, origins) for pick in picks]
    # Text is no number; what it says as a time is for `Seconds` to tell.
    numbers = [
        pl.repeat(None, len(column), dtype=pl.Float64, eager=True)
        if column.dtype == pl.String
        else column
        for column in written
    ]
    return Rows(numbers, written)


def _written(part: pl.DataFrame, pick: Pick, origins: dict[str, int]) -> pl.Series:
    series = _column(part, pick.field.name)
    if isinstance(series.dtype, pl.List):
        series = _element(series, pick)
    elif isinstance(series.dtype, pl.Array):
        series = series.arr.get(pick.at[1] or 0)
    if pick.field.is_clock and series.dtype == pl.String:
        return series
    if pick.field.is_clock:
        return _seconds(series, pick.field.name, origins)
    if isinstance(series.dtype, pl.Duration):
        return series.to_physical().cast(pl.Float64) / _PER_SECOND[series.dtype.time_unit or "us"]
    whole = series.dtype.is_integer() and not series.null_count()
    return series if whole else series.cast(pl.Float64, strict=False)


def _needs_a_look(kind: _DataType) -> bool:
    if isinstance(kind, pl.Struct):
        return any(_needs_a_look(entry.dtype) for entry in kind.fields)
    return isinstance(kind, pl.List | pl.String)


def _fields(name: str, kind: _DataType, first: pl.Series | None) -> Iterator[RecordedField]:
    if isinstance(kind, pl.Struct):
        for entry in kind.fields:
            inner = first.struct.field(entry.name) if first is not None else None
            yield from _fields(f"{name}.{entry.name}", entry.dtype, inner)
    elif isinstance(kind, pl.List) and _is_number(kind.inner):
        size = first.list.len().item() if first is not None and len(first) else 0
        yield RecordedField(name, (None, size or 0))
    elif isinstance(kind, pl.Array) and _is_number(kind.inner):
        yield RecordedField(name, (None, *kind.shape))
    elif isinstance(kind, pl.Datetime | pl.Time) or _is_clock(kind, first):
        yield RecordedField(name, is_clock=True)
    elif _is_number(kind):
        yield RecordedField(name, is_duration=isinstance(kind, pl.Duration))
    elif isinstance(kind, pl.Boolean):
        yield RecordedField(name, is_truth=True)
    else:
        yield RecordedField(name, holds=str(kind))


def _is_clock(kind: _DataType, first: pl.Series | None) -> bool:
    """Whether a column of text has dates and times of day."""
    if not isinstance(kind, pl.String) or first is None or not len(first):
        return False
    return first[0] is not None and is_clock(str(first[0]))


def _is_number(kind: _DataType) -> bool:
    return kind.is_numeric() or kind == pl.Null or isinstance(kind, pl.Duration)


def _column(part: pl.DataFrame, name: str) -> pl.Series:
    """A column, or an entry of a struct, whose name may hold dots."""
    top = _top(part.columns, name)
    series, rest = part[top], name[len(top) + 1 :]
    while isinstance(series.dtype, pl.Struct):
        entry = next(e.name for e in series.dtype.fields if f"{rest}.".startswith(f"{e.name}."))
        series, rest = series.struct.field(entry), rest[len(entry) + 1 :]
    return series


def _top(columns: Sequence[str], name: str) -> str:
    if name in columns:
        return name
    return next(column for column in columns if name.startswith(f"{column}."))


def _element(series: pl.Series, pick: Pick) -> pl.Series:
    """An element of each list, null where the list is not as long as the first one."""
    _, size = pick.field.shape
    element = series.list.get(pick.at[1] or 0, null_on_oob=True)
    return element.set((series.list.len() != size).fill_null(True), None)


def _seconds(series: pl.Series, name: str, origins: dict[str, int]) -> pl.Series:
    unit = series.dtype.time_unit if isinstance(series.dtype, pl.Datetime) else "ns"
    ticks = series.to_physical()
    if name not in origins and len(ticks) and ticks[0] is not None:
        origins[name] = ticks[0]
    return (ticks - origins.get(name, 0)).cast(pl.Float64) / _PER_SECOND[unit or "us"]
