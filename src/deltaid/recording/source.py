"""Where a log lies, on the disk or in memory: its name, what it holds, and how a file is opened."""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError, quoted
from deltaid.recording.address import Pick, RecordedField, locate, printable

Column = pl.Series | np.ndarray
# Rows that are read or looked at together, unless a file has pieces of its own.
BATCH_ROWS = 1 << 16


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of some columns as a recording holds them.

    Attributes:
        numbers: one array or series a column; null or NaN where there is no number.
        written: the same as it stands in the file, for messages.
    """

    numbers: Sequence[Column]
    written: Sequence[Column]

    @property
    def size(self) -> int:
        """How many rows there are."""
        return len(self.numbers[0])


@dataclass(frozen=True)
class LogTable(ABC):
    """A log that was opened: where it is, what it holds, and how to read it.

    Each kind of file has a class of its own, which may hold more about the layout.

    Attributes:
        path: of the file; of a table in memory its name.
        fields: what it holds, columns and arrays, in order.
        first_row: of the first data, as a user counts it: a line of a CSV file, otherwise 1.
        units: of columns, as the file states them.
        warnings: what was seen of the layout.
        cure_of_missing: what to do about a column that is not there.
        cure_without_torque: what to do if no torques are among the default columns.
        doubts: what was seen while all rows were read last.
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
        """Names of what it holds."""
        return tuple(entry.name for entry in self.fields)

    @property
    def header_place(self) -> str:
        """Where the names stand, for messages."""
        return str(self.path)

    @abstractmethod
    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Some columns by their addresses, all rows in order, in pieces of any length.

        Dates come as seconds since the first row, computed from whole numbers.

        Raises:
            RecordingError: the file is damaged, or a column does not hold numbers.
        """

    def picks(self, columns: Sequence[str]) -> list[Pick]:
        """Columns by their addresses.

        Raises:
            RecordingError: one of them is not there, holds no numbers, or is longer than others.
        """
        return locate(self.fields, columns, self.header_place, self.cure_of_missing)

    def checksum(self, columns: Sequence[str]) -> str:
        """SHA-256 of the file, or of these columns of a table in memory."""
        with opened(self.path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def row_place(self, row: int) -> str:
        """One row, for messages."""
        return f"{self.path}, row {row}"

    def row_name(self, row: int) -> str:
        """One row without the file, for a message that names the file already."""
        return self.row_place(row).removeprefix(f"{self.path}, ")

    def bad_value(self, column: str, written: object, place: str) -> RecordingError:
        """A field of a column that is no finite number, as it stands in the file."""
        text = "" if written is None else printable(str(written))
        what = f"is '{text[:40]}', not a finite number" if text else "is empty"
        return RecordingError(f"column {quoted(column)} {what}", where=place, cure=self.cure(text))

    def cure(self, written: str) -> str:
        """What to do about a field that is no number."""
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
    """Turn what the system says about a file that cannot be read into a message.

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


def first_line(error: BaseException) -> str:
    """What an error says, shortened."""
    return quoted(str(error).strip().split("\n", 1)[0])


def library(name: str, kind: str, path: Path) -> Any:
    """A module that reads a kind of file.

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
            cure=f"pip install {package}",
        ) from None
