"""Where a log lies, on the disk or in memory: its name, its layout, and how a file is opened."""

from bisect import bisect_right
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path

import polars as pl

from deltaid.errors import RecordingError


@dataclass(frozen=True)
class Table:
    """A log: where it is, its header, and how it is written.

    Attributes:
        path: of the file; of a table in memory its name.
        separator: between the fields of a CSV file; otherwise empty.
        header_row, first_row: of the names and of the first data, as a user counts them: lines of a
            CSV file, otherwise data rows, both from 1.
        data_start: where in a CSV file the first data row starts [bytes].
        ends_open: whether a CSV file ends without a line break.
        frame: the table in memory; None for a file.
        data_size: of the data in a CSV file [bytes].
        units: of columns, as a CSV file states them under its header.
        warnings: what was seen of the layout.
        comments: for each comment line that was met among the data, the row after it, comments not
            counted.
        marked: comment lines that hold a number for every column but the first.
    """

    path: Path
    header: tuple[str, ...]
    separator: str = ""
    header_row: int = 0
    first_row: int = 1
    data_start: int = 0
    ends_open: bool = False
    frame: pl.DataFrame | None = field(default=None, repr=False, compare=False)
    data_size: int = 0
    units: dict[str, str] = field(default_factory=dict[str, str])
    warnings: tuple[str, ...] = ()
    comments: list[int] = field(default_factory=list[int])
    marked: list[int] = field(default_factory=list[int])

    @property
    def header_place(self) -> str:
        """Where the names stand, for messages."""
        return self.row_place(self.header_row) if self.separator else str(self.path)

    def line(self, row: int) -> int:
        """A row as a user counts it: with the comment lines among the data."""
        return row + bisect_right(self.comments, row)

    def row_place(self, row: int) -> str:
        """One row, for messages."""
        return f"{self.path}, row {self.line(row)}"


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
    """Turn what the system or polars say about a file that cannot be read into one message.

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
        reason = error.strerror or _first_line(error)
        raise RecordingError(
            f"cannot be read: {reason}", where=str(path), cure="check its name and permissions"
        ) from None
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise RecordingError(
            f"is no Parquet file, or a damaged one: {_first_line(error)}",
            where=str(path),
            cure="copy or export it again",
        ) from None


def require_numbers(table: Table, frame: pl.DataFrame | pl.LazyFrame) -> None:
    """Refuse columns of anything but numbers.

    Raises:
        RecordingError: with the column and what it holds.
    """
    for name, kind in frame.collect_schema().items():
        if not (kind.is_numeric() or kind == pl.Null):
            raise RecordingError(
                f"column {name} holds {kind}, not numbers",
                where=str(table.path),
                cure="store it as numbers; times as seconds since the start",
            )


def _first_line(error: BaseException) -> str:
    return str(error).strip().split("\n", 1)[0][:200]
