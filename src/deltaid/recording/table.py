"""Reading a log in batches of constant memory, with the row and column of whatever is not a number.

CSV comes in blocks of bytes cut at line ends, Parquet in slices; polars parses both. Rows are
counted as a user sees them: the line of a CSV file (its header is line 1), the data row of a
Parquet file from 1.
"""

import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.columns import Columns

_BLOCK_BYTES = 4 << 20
_BLOCK_ROWS = 1 << 16
_SEPARATORS = (",", ";", "\t")


@dataclass(frozen=True)
class Table:
    """A log file: where it is, its header, and how it is written."""

    path: Path
    header: tuple[str, ...]
    separator: str  # empty for Parquet

    @property
    def first_row(self) -> int:
        """Number of the first data row as a user counts it."""
        return 2 if self.separator else 1


@dataclass(frozen=True)
class Batch:
    """Consecutive rows in SI units, columns as in `Columns.all`; `row` numbers the first one."""

    row: int
    values: Float[np.ndarray, "rows channels"]


def open_table(path: Path) -> Table:
    """Find out what kind of file a log is and read its header.

    Raises:
        RecordingError: the file is missing, empty, or neither CSV nor Parquet.
    """
    if not path.is_file():
        raise RecordingError("no such file", where=str(path))
    if path.suffix.lower() in (".parquet", ".pq"):
        try:
            return Table(path, tuple(pl.read_parquet_schema(path)), "")
        except (pl.exceptions.PolarsError, OSError) as error:
            raise RecordingError(f"is not a Parquet file: {error}", where=str(path)) from None
    with path.open("rb") as file:
        line = file.readline(1 << 20)
    try:
        text = line.decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        raise RecordingError("is neither CSV in UTF-8 nor Parquet", where=str(path)) from None
    if not text:
        raise RecordingError("is empty, or starts with an empty line", where=str(path))
    separator = max(_SEPARATORS, key=text.count)
    names = tuple(name.strip().strip('"') for name in text.split(separator))
    _check_header(path, names)
    return Table(path, names, separator)


def read_batches(table: Table, columns: Columns) -> Iterator[Batch]:
    """The rows of a log in SI units, batch by batch.

    Raises:
        RecordingError: a value is missing, not a number or not finite; names row and column.
    """
    row = table.first_row
    for frame in _csv_frames(table) if table.separator else _parquet_frames(table):
        yield Batch(row, _to_si(frame, table, columns, row))
        row += frame.height


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_header(path: Path, names: tuple[str, ...]) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise RecordingError(f"has two columns called '{repeated[0]}'", where=f"{path}, row 1")

    def is_number(name: str) -> bool:
        try:
            float(name)
        except ValueError:
            return False
        return True

    if all(is_number(name) for name in names):
        raise RecordingError(
            "has no header: its first row holds numbers",
            where=f"{path}, row 1",
            cure="put a row of column names first, such as t,q1,q2,q3,tau1,tau2,tau3",
        )


def _parquet_frames(table: Table) -> Iterator[pl.DataFrame]:
    scan, offset = pl.scan_parquet(table.path), 0
    while True:
        try:
            frame = scan.slice(offset, _BLOCK_ROWS).collect()
        except pl.exceptions.PolarsError as error:
            raise RecordingError(f"cannot be read: {error}", where=str(table.path)) from None
        if not frame.height:
            return
        yield frame
        offset += frame.height


def _csv_frames(table: Table) -> Iterator[pl.DataFrame]:
    """Blocks of lines as frames of strings: only then is the place of a bad value known."""
    with table.path.open("rb") as file:
        file.readline()
        row, rest = table.first_row, b""
        while block := file.read(_BLOCK_BYTES):
            block = rest + block
            cut = block.rfind(b"\n") + 1
            rest = block[cut:]
            if cut:
                frame = _parse_csv(block[:cut], table, row)
                yield frame
                row += frame.height
        if rest.strip():
            yield _parse_csv(rest, table, row)


def _parse_csv(block: bytes, table: Table, row: int) -> pl.DataFrame:
    try:
        frame = pl.read_csv(
            io.BytesIO(block),
            has_header=False,
            new_columns=list(table.header),
            separator=table.separator,
            infer_schema=False,
            raise_if_empty=False,
        )
    except pl.exceptions.PolarsError:
        raise _ragged(block, table, row) from None
    if frame.width != len(table.header) or frame.height != block.count(b"\n") + (
        not block.endswith(b"\n")
    ):
        raise _ragged(block, table, row)
    return frame


def _ragged(block: bytes, table: Table, row: int) -> RecordingError:
    """The error for the first line of a block that has another number of fields than the header."""
    for i, line in enumerate(block.splitlines()):
        fields = line.count(table.separator.encode()) + 1
        if not line.strip():
            what = "is an empty line"
        elif fields != len(table.header):
            what = f"has {fields} fields, but the header has {len(table.header)}"
        else:
            continue
        cure = "is the file cut off there, or is a decimal comma used?"
        return RecordingError(what, where=f"{table.path}, row {row + i}", cure=cure)
    return RecordingError("is not valid CSV", where=f"{table.path}, row {row} and following")


def _to_si(
    frame: pl.DataFrame, table: Table, columns: Columns, row: int
) -> Float[np.ndarray, "rows channels"]:
    values = np.empty((frame.height, len(columns.all)), order="F")
    for k, channel in enumerate(columns.all):
        series = frame[channel.column]
        if series.dtype == pl.String:
            series = series.str.strip_chars()
        numbers = series.cast(pl.Float64, strict=False).to_numpy()
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size:
            text = series[int(bad[0])]
            what = "is empty" if text in (None, "") else f"is '{text}', not a finite number"
            raise RecordingError(
                f"column {channel.column} {what}"
                + (f" ({bad.size} such values in this stretch)" if bad.size > 1 else ""),
                where=f"{table.path}, row {row + int(bad[0])}",
                cure="remove or repair these rows; deltaid does not fill gaps",
            )
        values[:, k] = channel.scale * (numbers - channel.zero)
    return values
