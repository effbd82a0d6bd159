"""Sources of logs on the disk or in memory: base class of tables, and opening of files.

A file is a stream of bytes, text in UTF-8, also if it is compressed or in UTF-16. It is unpacked
and transcoded chunk by chunk each time it is read, so memory stays constant.
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
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError, quoted, visible
from deltaid.recording.address import Pick, RecordedField, locate

Column = pl.Series | np.ndarray
# What polars raises for tables that it cannot read.
POLARS_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException)
RENAME = "rename one"  # of several columns that have one name
# Key of doubts about rows that are excluded because the file has not all their numbers.
INCOMPLETE = "incomplete-rows"
# Rows of a batch.
BATCH_ROWS = 1 << 16
# Bytes read at once: few, because a chunk may unpack to a thousand times its size. The first ones
# show the kind of a file.
CHUNK = 1 << 14
_GZIP = b"\x1f\x8b"
ZSTD = b"\x28\xb5\x2f\xfd"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of some columns as a recording holds them.

    Attributes:
        numbers: an array or series per column; null or NaN where there is no number.
        written: the same as in the file, for messages.
        size: number of rows.
    """

    numbers: Sequence[Column]
    written: Sequence[Column]

    @property
    def size(self) -> int:
        return len(self.numbers[0])


@dataclass(frozen=True)
class LogTable(ABC):
    """An opened log: its place, its fields, and how to read it.

    Each kind of file has a class of its own.

    Attributes:
        path: of the file; the name of a table in memory.
        fields: columns and arrays, in order.
        first_row: of the first data, as a user counts it: a line of a CSV file, otherwise 1.
        units: of columns, as the file states them.
        warnings: doubts about the layout.
        cure_of_missing: fix of a missing column.
        cure_without_torque: fix of missing torques among the default columns.
        doubts: about the rows, of the last time that all were read.
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
        """Columns by their addresses, all rows in order, in pieces of any length.

        Dates come as seconds since the first row, computed from whole numbers.

        Raises:
            RecordingError: the file is damaged, or a column does not hold numbers.
        """

    def picks(self, columns: Sequence[str]) -> list[Pick]:
        """Columns by their addresses.

        Raises:
            RecordingError: one is missing, holds no numbers, or is longer than others.
        """
        return locate(self.fields, columns, self.header_place, self.cure_of_missing)

    def checksum(self, columns: Sequence[str]) -> str:
        """SHA-256 of the file, or of these columns of a table in memory."""
        with opened(self.path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def row_place(self, row: int) -> str:
        """Place of a row, for messages."""
        return f"{self.path}, row {row}"

    def row_name(self, row: int) -> str:
        """Place of a row without the file, for messages that name the file."""
        return self.row_place(row).removeprefix(f"{self.path}, ")

    def repeated(self, name: str) -> str:
        """The columns of one name, if there are several; else empty."""
        places = [str(k) for k, other in enumerate(self.header, start=1) if other == name]
        several = f"has {len(places)} columns called {name} (columns {' and '.join(places)})"
        return several if len(places) > 1 else ""

    def bad_value(self, column: str, written: object, place: str) -> RecordingError:
        """Error of a field that is no finite number."""
        text = "" if written is None else visible(str(written), kept="")
        what = f"is '{text[:40]}', not a finite number" if text else "is empty"
        return RecordingError(f"column {quoted(column)} {what}", where=place, cure=self.cure(text))

    def cure(self, written: str) -> str:
        """Fix of a field that is no number."""
        return "remove or repair such rows; deltaid does not fill gaps"


@contextmanager
def opened(path: Path) -> Generator[BufferedReader, None, None]:
    """A file open for reading bytes.

    Raises:
        RecordingError: it is missing, is no file, or cannot be read.
    """
    with readable(path):
        if path.is_dir():
            raise RecordingError(
                "is a folder, not a log", where=str(path), cure="give the name of a file in it"
            )
        if path.exists() and not path.is_file():
            raise RecordingError(
                "is no regular file", where=str(path), cure="a log is read twice, so store it first"
            )
        with path.open("rb") as file:
            yield file


@contextmanager
def readable(path: Path) -> Generator[None, None, None]:
    """Turn errors of the system about a file into a message.

    Raises:
        RecordingError: with the file's name.
    """
    try:
        yield
    except FileNotFoundError:
        raise RecordingError(
            "no such file", where=str(path), cure="check its name and folder"
        ) from None
    except OSError as error:
        reason = error.strerror or first_line(error)
        raise RecordingError(
            f"cannot be read: {reason}", where=str(path), cure="check its name and permissions"
        ) from None


@contextmanager
def damage(
    where: Path | str,
    errors: type[BaseException] | tuple[type[BaseException], ...],
    what: str,
    cure: str = "copy or export it again",
) -> Generator[None, None, None]:
    """Turn errors of a library about the content of a file into a message.

    Raises:
        RecordingError: with what is damaged, and the error's first line; or one that is a message
            already.
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
    """A module that reads a kind of file.

    Args:
        name, kind: of the module, and of the file, for messages.
        or_else: another fix than to install it.

    Raises:
        RecordingError: it is not installed.
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
    """A log open for reading, uncompressed, and in UTF-8 if it was in UTF-16.

    Raises:
        RecordingError: it cannot be read, its compressed data is damaged or cut off, or the library
            for it is missing.
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
    """Decompressed zstd data.

    Raises:
        RecordingError: it is damaged, or the library for it is missing.
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
    """Decompressed data of all members or frames."""
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
