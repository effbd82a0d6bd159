"""Tables of polars as numbers (lists, structs, dates, times as text, decimals), and Parquet files.

Rust aborts the process if an allocation fails, and one in thousands of damaged Parquet files makes
polars request 10¹⁸ bytes. No exception is raised then, and opening every file in a separate process
would cost each command a quarter of a second. So a handler of the abort prints a message.
"""

import ctypes
import hashlib
import os
import signal
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from deltaid.errors import RecordingError
from deltaid.files import readable
from deltaid.recording.address import Pick, RecordedField
from deltaid.recording.source import BATCH_ROWS, POLARS_ERRORS, LogTable, Rows, damage
from deltaid.recording.time.counts import PER_SECOND, in_seconds, is_clock

# A type of polars, whose class the run-time check of types cannot resolve.
_DataType = Any
# Name, type and expression of a plain column or entry.
_Entry = tuple[str, _DataType, pl.Expr]


def fields_of(frame: pl.LazyFrame) -> tuple[RecordedField, ...]:
    """Fields of a table; entries of structs are fields such as `pose.x`.

    Reads one row to determine the lengths of lists, and whether text is a time.
    """
    entries = _entries(frame)
    unclear = [
        expression.alias(str(k))
        for k, (_, kind, expression) in enumerate(entries)
        if isinstance(kind, pl.List | pl.String)
    ]
    first = frame.select(unclear).head(1).collect().to_dict()
    return tuple(_field(name, kind, first.get(str(k))) for k, (name, kind, _) in enumerate(entries))


def selected(frame: pl.LazyFrame, picks: Sequence[Pick]) -> pl.LazyFrame:
    """Fields of some picks in their order, with numbers as names."""
    expressions = {name: expression for name, _, expression in _entries(frame)}
    return frame.select(expressions[pick.field.name].alias(str(k)) for k, pick in enumerate(picks))


def _entries(frame: pl.LazyFrame) -> list[_Entry]:
    columns = frame.collect_schema().items()
    return [entry for name, kind in columns for entry in _under(name, kind, pl.col(name))]


def _under(name: str, kind: _DataType, expression: pl.Expr) -> Iterator[_Entry]:
    """A plain column, or the entries of a struct and of the structs in it."""
    if not isinstance(kind, pl.Struct):
        yield name, kind, expression
        return
    for entry in kind.fields:
        inner = expression.struct.field(entry.name)
        yield from _under(f"{name}.{entry.name}", entry.dtype, inner)


def rows_of(part: pl.DataFrame, picks: Sequence[Pick]) -> Rows:
    """Columns of consecutive rows of `selected` fields; null without a number."""
    written = [_written(*pair) for pair in zip(part, picks, strict=True)]
    # Text is no number; `in_seconds` converts text that is a time.
    numbers = [
        pl.repeat(None, len(column), dtype=pl.Float64, eager=True)
        if column.dtype == pl.String
        else column
        for column in written
    ]
    return Rows(numbers, written)


def _written(series: pl.Series, pick: Pick) -> pl.Series:
    if isinstance(series.dtype, pl.List):
        element = series.list.get(pick.at[1] or 0, null_on_oob=True)
        # Lists of another length than the first one become null.
        series = element.set((series.list.len() != pick.field.shape[1]).fill_null(True), None)
    elif isinstance(series.dtype, pl.Array):
        series = series.arr.get(pick.at[1] or 0)
    if isinstance(series.dtype, pl.Duration):
        series = series.to_physical().cast(pl.Float64) / PER_SECOND[series.dtype.time_unit or "us"]
    whole = series.dtype.is_integer() and not series.null_count()
    return series if whole or pick.field.is_clock else series.cast(pl.Float64, strict=False)


def _field(name: str, kind: _DataType, first: pl.Series | None) -> RecordedField:
    if isinstance(kind, pl.List) and _is_number(kind.inner):
        size = first.list.len().item() if first is not None and len(first) else 0
        return RecordedField(name, (None, size or 0))
    if isinstance(kind, pl.Array) and _is_number(kind.inner):
        return RecordedField(name, (None, *kind.shape))
    if isinstance(kind, pl.Datetime | pl.Time) or is_clock(first):
        return RecordedField(name, is_clock=True)
    if _is_number(kind):
        return RecordedField(name, is_duration=isinstance(kind, pl.Duration))
    if isinstance(kind, pl.Boolean):
        return RecordedField(name, is_truth=True)
    return RecordedField(name, holds=str(kind))


def _is_number(kind: _DataType) -> bool:
    return kind.is_numeric() or kind == pl.Null or isinstance(kind, pl.Duration)


def open_parquet(path: Path) -> LogTable:
    with _decoding(path):
        return ParquetTable(path, fields_of(_scan(path)))


@dataclass(frozen=True)
class ParquetTable(LogTable):
    """An open Parquet file; one slice and its row group are in memory at a time."""

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        picks, row = self.picks(columns), 0
        with _decoding(self.path):
            frame = selected(_scan(self.path), picks)
        while True:
            with _decoding(self.path):
                part = frame.slice(row, BATCH_ROWS).collect()
                rows = rows_of(part, picks)
            if not part.height:
                return
            yield rows
            row += part.height


def _scan(path: Path) -> pl.LazyFrame:
    return pl.scan_parquet(path, glob=False, hive_partitioning=False)


@contextmanager
def _decoding(path: Path) -> Generator[None, None, None]:
    """Convert errors of polars about a damaged file to one message.

    Its threads print their panic to file descriptor 2 before the exception is raised, so the
    descriptor is redirected.
    """
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    what, cure = "is no Parquet file, or a damaged one", "copy or export it again"
    end = RecordingError(f"{what}: polars cannot go on", where=str(path), cure=cure)
    try:
        os.dup2(nowhere, 2)
        with (
            last_words(str(end), kept),
            readable(path, RecordingError),
            damage(path, POLARS_ERRORS, what, cure),
        ):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def last_words(message: str, descriptor: int) -> Generator[None, None, None]:
    """Write a message to a file descriptor if the process is aborted, and exit with code 2.

    The handler is no Python signal handler, which would run too late. Windows has no such signal.
    """
    if sys.platform == "win32":
        yield
        return
    text = f"error: {message}\n".encode(errors="replace")

    def end(_: int) -> None:
        os.write(descriptor, text)
        os._exit(2)

    library = ctypes.CDLL(None)
    library.signal.restype = ctypes.c_void_p
    library.signal.argtypes = [ctypes.c_int, ctypes.c_void_p]
    handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(end)
    before = library.signal(signal.SIGABRT, ctypes.cast(handler, ctypes.c_void_p))
    try:
        yield
    finally:
        library.signal(signal.SIGABRT, before)


@dataclass(frozen=True, eq=False)
class FrameTable(LogTable):
    """A table of polars in memory."""

    frame: pl.DataFrame = field(repr=False)
    cure_of_missing: str = field(
        default="rename what there is to t, q1…, tau1… (and qd1…, qdd1… if recorded) or to arrays "
        "t, q, tau, or say which is which: columns=deltaid.ColumnMapping(…)",
        kw_only=True,
    )

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        picks = self.picks(columns)
        for part in selected(self.frame.lazy(), picks).collect().iter_slices(BATCH_ROWS):
            yield rows_of(part, picks)

    def checksum(self, columns: Sequence[str]) -> str:
        """SHA-256 of these columns: their addresses, and their numbers as binary64 without units.

        Equal numbers from arrays, polars or pandas have equal checksums, unlike those from a file.
        """
        digest = hashlib.sha256("\0".join(columns).encode())
        has_dates = self.picks(columns)[0].field.is_clock
        for rows in in_seconds(self.rows(columns)) if has_dates else self.rows(columns):
            for numbers in rows.numbers:
                digest.update(np.asarray(numbers, dtype=np.float64).tobytes())
        return digest.hexdigest()
