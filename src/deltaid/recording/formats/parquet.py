"""Parquet, read in slices.

Rust code aborts the whole process if it cannot have memory, and one damaged Parquet file in some
thousands makes polars ask for 10¹⁸ bytes. No exception ever arrives then; trying every file in a
process of its own would cost each command a quarter of a second. So a message is ready for it.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from deltaid.errors import RecordingError
from deltaid.recording.frames import fields_of, rows_of, tops
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import LogTable, Rows, first_line, readable

# Several slices share a row group, of which each decodes more than its own rows.
_SLICE_ROWS = 1 << 17


def open_parquet(path: Path, mapping: ColumnMapping) -> LogTable:
    """A Parquet file: columns and types by its schema."""
    with _decoding(path):
        return ParquetTable(path, fields_of(_scan(path)))


@dataclass(frozen=True)
class ParquetTable(LogTable):
    """An open Parquet file; in memory are a slice at a time and the row group that holds it."""

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Rows of some columns, as in `LogTable.rows`."""
        picks, origins, row = self.picks(columns), dict[str, int](), 0
        with _decoding(self.path):
            frame = _scan(self.path)
            frame = frame.select(tops(frame.collect_schema().names(), picks))
        while True:
            with _decoding(self.path):
                part = frame.slice(row, _SLICE_ROWS).collect()
                found = rows_of(part, picks, origins)
            if not part.height:
                return
            yield found
            row += part.height


def _scan(path: Path) -> pl.LazyFrame:
    return pl.scan_parquet(path, glob=False, hive_partitioning=False)


@contextmanager
def _decoding(path: Path) -> Generator[None, None, None]:
    """Turn what polars says about a damaged file into one message.

    Its threads panic, and each reports that on file descriptor 2 before an exception with the
    reason arrives here.
    """
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with last_words(str(_damaged(path, "polars cannot go on")), kept), readable(path):
            yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise _damaged(path, first_line(error)) from None
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _damaged(path: Path, reason: str) -> RecordingError:
    return RecordingError(
        f"is no Parquet file, or a damaged one: {reason}",
        where=str(path),
        cure="copy or export it again",
    )


@contextmanager
def last_words(message: str, descriptor: int) -> Generator[None, None, None]:
    """Write a message on a file descriptor if the process is aborted, and end it with code 2.

    A handler of Python's own would run only after it is too late. Windows has no such signal.
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
