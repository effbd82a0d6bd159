"""Base class of tables of logs, and files of logs as streams of bytes.

Compressed files are unpacked, and UTF-16 is converted to UTF-8, chunk by chunk in each pass, so
memory stays constant.
"""

import codecs
import hashlib
import io
import sys
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError, quoted, visible
from deltaid.files import readable
from deltaid.recording.address import Pick, RecordedField, locate

ColumnValues = pl.Series | np.ndarray
# Errors of polars for tables that it cannot read.
POLARS_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException)
RENAME = "rename one"  # fix of several columns with one name
# Key of doubts about rows that are excluded because some of their numbers are missing.
INCOMPLETE = "incomplete-rows"
# Rows per batch.
BATCH_ROWS = 1 << 16
# Bytes read at once: few, because they may unpack to a thousand times as many. The first chunk
# shows the kind of a file.
CHUNK = 1 << 14
_GZIP = b"\x1f\x8b"
ZSTD = b"\x28\xb5\x2f\xfd"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of some columns, in the units of the recording.

    Attributes:
        numbers: an array or series per column; null or NaN where the recording has no number.
        written: the same values as they are written in the file, for messages.
        size: number of rows.
    """

    numbers: Sequence[ColumnValues]
    written: Sequence[ColumnValues]

    @property
    def size(self) -> int:
        return len(self.numbers[0])


@dataclass(frozen=True)
class LogTable(ABC):
    """Base class of open logs; each kind of file has a class.

    Attributes:
        path: path of the file, or the name of a table in memory.
        fields: columns and arrays, in order.
        first_row: number of the first row of data: the line of a CSV file, otherwise 1.
        units: units of columns, as the file states them.
        warnings: doubts about the layout.
        cure_of_missing: fix of a missing column.
        cure_without_torque: fix of missing torques among the default columns.
        doubts: doubts about the rows, from the last full pass.
        header: names of the fields.
    """

    path: Path
    fields: tuple[RecordedField, ...]
    first_row: int = field(default=1, kw_only=True)
    units: dict[str, str] = field(default_factory=dict[str, str], kw_only=True)
    warnings: tuple[Doubt, ...] = field(default=(), kw_only=True)
    cure_of_missing: str = field(
        default="rename what there is to t, q1…, tau1… (and qd1…, qdd1… if recorded) or to arrays "
        "t, q, tau, or say which is which with --columns MAPPING.yaml",
        kw_only=True,
    )
    cure_without_torque: str = field(
        default="name them tau1, tau2, … or declare them with --columns MAPPING.yaml", kw_only=True
    )
    doubts: list[Doubt] = field(default_factory=list[Doubt], compare=False, kw_only=True)

    @property
    def header(self) -> tuple[str, ...]:
        return tuple(entry.name for entry in self.fields)

    @property
    def header_place(self) -> str:
        """Place of the names, for messages."""
        return str(self.path)

    @abstractmethod
    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Read all rows of some columns in order, in pieces of any length.

        Args:
            columns: addresses of the columns.

        Raises:
            RecordingError: the file is damaged, or a column does not hold numbers.
        """

    def picks(self, columns: Sequence[str]) -> list[Pick]:
        """Fields and indices of columns by their addresses.

        Raises:
            RecordingError: a column is missing, holds no numbers, or is longer than others.
        """
        return locate(self.fields, columns, self.header_place, self.cure_of_missing)

    def can_read(self, columns: Sequence[str]) -> bool:
        """Whether columns can be read together."""
        try:
            self.picks(columns)
        except RecordingError:
            return False
        return True

    def checksum(self, columns: Sequence[str]) -> str:
        """SHA-256 of the file, or of these columns of a table in memory."""
        with opened(self.path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def row_place(self, row: int) -> str:
        """Place of a row, for messages."""
        return f"{self.path}, {self.row_name(row)}"

    def row_name(self, row: int) -> str:
        """Place of a row without the file, for messages that already name the file."""
        return f"row {row}"

    def repeated(self, name: str) -> str:
        """Message about several columns of one name; empty if there is one at most."""
        places = [str(k) for k, other in enumerate(self.header, start=1) if other == name]
        several = f"has {len(places)} columns called {name} (columns {' and '.join(places)})"
        return several if len(places) > 1 else ""

    def bad_value(
        self, column: str, written: object, place: str, otherwise: str = ""
    ) -> RecordingError:
        """Error for a field that is not a finite number; `otherwise` is one more fix."""
        text = "" if written is None else visible(str(written), kept="")
        what = f"is '{text[:40]}', not a finite number" if text else "is empty"
        cure = self.cure(text) + otherwise
        return RecordingError(f"column {quoted(column)} {what}", where=place, cure=cure)

    def cure(self, written: str) -> str:
        """Fix of a field that is not a number."""
        return "remove or repair such rows; deltaid does not fill gaps"


@contextmanager
def opened(path: Path) -> Generator[io.BufferedReader, None, None]:
    """Open a file for reading bytes.

    Raises:
        RecordingError: the file is missing, is no regular file, or cannot be read.
    """
    with readable(path, RecordingError):
        if path.exists() and not path.is_file():
            raise RecordingError(
                "is no regular file", where=str(path), cure="a log is read twice, so store it first"
            )
        with path.open("rb") as file:
            yield file


@contextmanager
def damage(
    where: Path | str,
    errors: type[BaseException] | tuple[type[BaseException], ...],
    what: str,
    cure: str = "copy or export it again",
) -> Generator[None, None, None]:
    """Convert errors of a library about the content of a file to a message.

    Raises:
        RecordingError: states `what` and the first line of the error; a RecordingError passes
            unchanged.
    """
    try:
        yield
    except RecordingError:
        raise
    except errors as error:
        reason = first_line(error) or type(error).__name__
        raise RecordingError(f"{what}: {reason}", where=str(where), cure=cure) from None


def first_line(error: BaseException) -> str:
    """First line of an error's text, shortened."""
    return visible(quoted(str(error).strip().split("\n", 1)[0]))


def library(name: str, kind: str, path: Path, or_else: str = "") -> Any:
    """Import the module that reads a kind of file.

    Args:
        name: name of the module.
        kind: kind of the file, for messages.
        or_else: a fix other than installing the module.

    Raises:
        RecordingError: the module is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError:
        package = name.partition(".")[0]
        raise RecordingError(
            f"is {kind}, and the library {package} that reads it is not installed",
            where=str(path),
            cure=f"pip install {package}{or_else}",
        ) from None


@contextmanager
def content(path: Path) -> Generator[io.BufferedReader, None, None]:
    """Open a log for reading: uncompressed, and in UTF-8 if it is in UTF-16.

    Raises:
        RecordingError: the log cannot be read, its compressed data is damaged or cut off, or the
            library for it is missing.
    """
    with opened(path) as file:
        stream, start = file, file.peek(4)
        if start.startswith(_GZIP):
            unpacker = partial(zlib.decompressobj, 31), zlib.error
            stream = _buffered(_unpacked(file, path, "gzip", *unpacker))
        elif start.startswith(ZSTD):
            stream = _buffered(_unpacked(file, path, "zstd", *_zstd(path)))
        if stream.peek(2).startswith(_UTF_16):
            stream = _buffered(_transcoded(stream))
        yield stream


def packed_by(path: Path) -> str:
    with opened(path) as file:
        start = file.peek(4)
    return "gzip" if start.startswith(_GZIP) else "zstd" if start.startswith(ZSTD) else ""


def unzstd(data: bytes, path: Path) -> bytes:
    """Decompress zstd data.

    Raises:
        RecordingError: the data is damaged, or the library for it is missing.
    """
    new, damaged = _zstd(path)
    with damage(path, damaged, "has damaged zstd data"):
        return new().decompress(data)


class _Chunks(io.RawIOBase):
    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._rest = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        self._rest = self._rest or next(filter(None, self._chunks), b"")
        size = min(len(buffer), len(self._rest))
        buffer[:size], self._rest = self._rest[:size], self._rest[size:]
        return size


def _buffered(chunks: Iterator[bytes]) -> io.BufferedReader:
    return cast("io.BufferedReader", io.BufferedReader(_Chunks(chunks)))


def _unpacked(
    file: io.BufferedReader,
    path: Path,
    kind: str,
    new: Callable[[], Any],
    damaged: type[Exception],
) -> Iterator[bytes]:
    """Decompressed data of all gzip members or zstd frames."""
    unpacker: Any = None
    while data := file.read(CHUNK):
        # Files from tapes and some loggers are padded with zeros.
        while data and (unpacker or data.strip(b"\0")):
            unpacker = unpacker or new()
            with damage(path, damaged, f"is a damaged {kind} file"):
                yield unpacker.decompress(data)
            data = unpacker.unused_data if unpacker.eof else b""
            unpacker = None if unpacker.eof else unpacker
    if unpacker:
        raise RecordingError(
            f"is a {kind} file that is cut off", where=str(path), cure="copy or export it again"
        )


def _zstd(path: Path) -> tuple[Callable[[], Any], type[Exception]]:
    if sys.version_info >= (3, 14):
        from compression import zstd

        return zstd.ZstdDecompressor, zstd.ZstdError
    kind = "a file compressed by zstd"
    zstandard = library("zstandard", kind, path, ", or unpack it by `zstd -d`")
    return zstandard.ZstdDecompressor().decompressobj, zstandard.ZstdError


def _transcoded(file: io.BufferedReader) -> Iterator[bytes]:
    decoder = codecs.getincrementaldecoder("utf-16")(errors="replace")
    while data := file.read1(1 << 16):
        yield decoder.decode(data).encode()
    yield decoder.decode(b"", final=True).encode()
