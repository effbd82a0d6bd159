"""Reading a log in batches of constant memory, whatever kind of file it is."""

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.columns import ColumnMapping, Columns
from deltaid.recording.csv_layout import open_csv
from deltaid.recording.csv_text import read_csv
from deltaid.recording.memory import frame_checksum, read_frame
from deltaid.recording.parquet import SIGNATURE, open_parquet, read_parquet
from deltaid.recording.source import Table, opened
from deltaid.recording.stream import content

# Rows of a batch, however the file is read, so that nothing depends on how it is.
_BATCH_ROWS = 1 << 16
_FOREIGN = {
    b"PK\x03\x04": "an Excel workbook or a ZIP archive",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook",
    b"MATLAB": "a MATLAB file",
    b"\x89HDF": "an HDF5 file (or a MATLAB file of version 7.3)",
}


@dataclass(frozen=True)
class Batch:
    """Consecutive rows in SI units, columns as in `Columns.all`; `row` numbers the first one."""

    row: int
    values: Float[np.ndarray, "rows channels"]


def open_table(path: Path, mapping: ColumnMapping | None = None) -> Table:
    """Find out what kind of file a log is and read its header.

    Args:
        path: the log.
        mapping: what to look for in CSV: names of columns, lines of the header and first data.

    Raises:
        RecordingError: the file is missing, empty, cannot be read, or is neither CSV nor Parquet.
    """
    with content(path) as file:
        start = file.read(8)
    if not start:
        raise RecordingError("is empty", where=str(path), cure="copy or export it again")
    if start.startswith(SIGNATURE) or path.suffix.lower() in (".parquet", ".pq"):
        return open_parquet(path)
    for signature, kind in _FOREIGN.items():
        if start.startswith(signature):
            raise RecordingError(
                f"is {kind}", where=str(path), cure="export it as CSV in UTF-8 or as Parquet"
            )
    return open_csv(path, mapping or ColumnMapping())


def read_batches(table: Table, columns: Columns) -> Iterator[Batch]:
    """The rows of a log in SI units, batch by batch.

    Raises:
        RecordingError: a value is missing, not a number or not finite; names row and column.
    """
    row = table.first_row
    in_file = read_csv if table.separator else read_parquet
    read = in_file if table.frame is None else read_frame
    for values in recut(read(table, columns.all), _BATCH_ROWS):
        yield Batch(row, values)
        row += len(values)


def recut(
    arrays: Iterable[Float[np.ndarray, "_ channels"]], size: int, overlap: int = 0
) -> Iterator[Float[np.ndarray, "_ channels"]]:
    """Join arrays and cut them into blocks that advance by `size` and share `overlap` rows.

    The last block is shorter; there is none if it would hold nothing but the overlap.
    """
    parts: list[np.ndarray] = []
    held = 0
    for array in arrays:
        parts.append(array)
        held += len(array)
        if held < size + overlap:
            continue
        rows, start = np.concatenate(parts), 0
        while start + size + overlap <= len(rows):
            yield rows[start : start + size + overlap]
            start += size
        parts, held = [rows[start:]], len(rows) - start
    if held > overlap:
        yield np.concatenate(parts)


def checksum(table: Table, columns: Columns) -> str:
    """SHA-256 of a file; of a table in memory that of its columns in use."""
    if table.frame is not None:
        return frame_checksum(table, columns.all)
    with opened(table.path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
