"""Reads logs of any kind of file in batches of constant memory.

To add a kind of file, write a module in `formats/` that opens it, and add it to `FORMATS`.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.forked import require_threads
from deltaid.recording.columns import Columns
from deltaid.recording.formats.arrays import is_npz, open_npy, open_npz
from deltaid.recording.formats.bag_reader import is_bag
from deltaid.recording.formats.csv import open_csv
from deltaid.recording.formats.frames import open_parquet
from deltaid.recording.formats.hdf5 import is_hdf5, open_hdf5
from deltaid.recording.formats.matlab import is_matlab, open_matlab
from deltaid.recording.formats.rosbag import open_bag
from deltaid.recording.formats.twincat import is_scope, open_scope
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import (
    BATCH_ROWS,
    CHUNK,
    ColumnValues,
    LogTable,
    Rows,
    content,
    packed_by,
)
from deltaid.recording.time.counts import Unwrapper, in_seconds, unwrappers
from deltaid.robot.part import LARGEST

_EXPORT, _UNPACK = "export it as CSV in UTF-8 or as Parquet", "unpack it"
# First bytes of kinds of files that are not supported, with the fix.
_FOREIGN = {
    rb"PK\x03\x04": ("an Excel workbook or a ZIP archive", f"{_EXPORT}, or {_UNPACK}"),
    rb"\xd0\xcf\x11\xe0": ("an old Excel workbook", _EXPORT),
    rb"(?:\xef\xbb\xbf)?\s*(?:\{|\[\s*[\[{])": ("JSON", _EXPORT),
    rb"(?i)(?:\xef\xbb\xbf)?\s*<(?:\?xml|!doctype|html)": ("XML or a web page", _EXPORT),
    rb"\xfd7zXZ\x00": ("a file compressed by xz", _UNPACK),
    rb"BZh[1-9]1AY&SY": ("a file compressed by bzip2", _UNPACK),
    rb"\x04\x22\x4d\x18": ("a file compressed by lz4", _UNPACK),
    rb"7z\xbc\xaf\x27\x1c": ("a 7z archive", _UNPACK),
    rb"Rar!\x1a\x07": ("a RAR archive", _UNPACK),
    rb"(?s).{257}ustar": ("a tar archive", _UNPACK),
}
# Numbers of states in words.
_STATES = {"true": 1.0, "on": 1.0, "false": 0.0, "off": 0.0}


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Attributes:
        name: name for messages, such as 'a Parquet file'.
        claims: returns whether a file is of this kind by its signature, given its first unpacked
            bytes (none for a folder) and its path.
        open: reads the file's fields, but no numbers. Raises a RecordingError if the file is
            damaged, or if the library that reads it is missing.
        suffixes: suffixes of such files, for those without a known signature.
        unpacks: whether `open` reads files that are compressed as a whole by gzip or zstd.
    """

    name: str
    claims: Callable[[bytes, Path], bool]
    open: Callable[[Path], LogTable]
    suffixes: tuple[str, ...] = ()
    unpacks: bool = False


# Kinds of files in the order of their checks; any other file is CSV, which has no signature.
FORMATS = (
    Format(
        "a Parquet file",
        lambda start, _: start.startswith(b"PAR1"),
        open_parquet,
        (".parquet", ".pq"),
    ),
    Format("an HDF5 file", is_hdf5, open_hdf5, (".h5", ".hdf5", ".hdf", ".he5", ".nc")),
    Format("a MATLAB file", is_matlab, open_matlab, (".mat",)),
    Format("a NumPy file", lambda start, _: start.startswith(b"\x93NUMPY"), open_npy, (".npy",)),
    Format("a NumPy archive", is_npz, open_npz, (".npz",)),
    Format("a ROS bag", is_bag, open_bag, (".bag", ".db3", ".mcap"), unpacks=True),
    Format("an export of TwinCAT Scope", is_scope, open_scope, unpacks=True),
)


def open_table(path: Path, mapping: ColumnMapping | None = None) -> LogTable:
    """Open a log of any kind, recognised by its signature, else by its name.

    Args:
        path: the log.
        mapping: for CSV: names of columns, lines of the header and first data.

    Raises:
        RecordingError: the file is missing, empty, cannot be read, or is of no known kind.
        DeltaidError: the process has lost its threads (`require_threads`).
    """
    require_threads()
    start = b""
    if not os.path.isdir(path):  # unlike Path.is_dir it never raises
        with content(path) as file:
            start = file.read(CHUNK)
        if not start:
            raise RecordingError("is empty", where=str(path), cure="copy or export it again")
    kind = next((kind for kind in FORMATS if kind.claims(start, path)), None)
    if kind and not kind.unpacks and (packing := packed_by(path)):
        raise RecordingError(f"is {kind.name} inside {packing}", where=str(path), cure="unpack it")
    if kind is None:
        for signature, (name, cure) in _FOREIGN.items():
            if re.match(signature, start):
                raise RecordingError(f"is {name}", where=str(path), cure=cure)
        suffix = path.suffix.lower()
        kind = next((kind for kind in FORMATS if suffix in kind.suffixes), None)
    return kind.open(path) if kind else open_csv(path, mapping or ColumnMapping())


def read_batches(
    table: LogTable, columns: Columns, unwrapping: Sequence[Unwrapper] = ()
) -> Iterator[Float[np.ndarray, "rows channels"]]:
    """Rows of a log in SI units, batch by batch, columns as in `Columns.all`.

    Batches have the same rows for all kinds of files.

    Args:
        unwrapping: new unwrappers of time and positions.

    Raises:
        RecordingError: a value is missing, not a number or not finite; names row and column.
    """
    yield from recut(_in_si(table, columns, unwrapping or unwrappers(columns)), BATCH_ROWS)


def _in_si(
    table: LogTable, columns: Columns, unwrapping: Sequence[Unwrapper]
) -> Iterator[Float[np.ndarray, "rows channels"]]:
    row, time = table.first_row, columns.time
    pieces = table.rows([channel.column for channel in columns.recorded])
    for rows in pieces if time.is_absent else in_seconds(pieces):
        if time.is_absent:
            count = np.arange(row - table.first_row, row - table.first_row + rows.size, dtype=float)
            rows = Rows([count, *rows.numbers], [count, *rows.written])
        values = np.asarray(rows.numbers[0]) if time.counts else np.zeros(0)
        for broken in np.flatnonzero(np.isfinite(values) & (values != np.round(values)))[
            :1
        ].tolist():
            raise RecordingError(
                f"column {time.column} counts no cycles: it is {float(values[broken]):.10g}",
                where=table.row_place(row + broken),
                cure=f"a column of times has a unit in place of a rate (time: {{column: "
                f"{time.column}, unit: s}}); a rate alone stands for the time of a log without",
            )
        yield to_si(table, columns, rows, row, unwrapping)
        row += rows.size


def to_si(
    table: LogTable, columns: Columns, rows: Rows, row: int, unwrapping: Sequence[Unwrapper]
) -> Float[np.ndarray, "rows channels"]:
    """Convert consecutive rows to SI units.

    Sensors without a number, or with an impossible one, are NaN.

    Args:
        table, columns: the log and its columns.
        rows: numbers of all of these columns.
        row: number of the first row.
        unwrapping: unwrappers of time and positions.

    Raises:
        RecordingError: a number is not finite; names the first such row.
    """
    channels = columns.all
    values = np.empty((rows.size, len(channels)), order="F")
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (channel, numbers) in enumerate(zip(channels, rows.numbers, strict=True)):
            # Null becomes NaN.
            array = numbers.to_numpy() if isinstance(numbers, pl.Series) else numbers
            if k < len(unwrapping):
                array = unwrapping[k].add(np.asarray(array, dtype=np.float64), row)
            if k >= columns.sensor_places.stop:
                array = _states(array, rows.written[k])
            np.subtract(array, channel.zero, out=values[:, k])
            if channel.scale != 1:
                values[:, k] *= channel.scale
    shown = values[:, columns.sensor_places]
    # Some loggers write a huge number, such as 1e38, for a missing one.
    shown[~(np.abs(shown) <= LARGEST)] = np.nan
    finite = np.isfinite(values)
    finite[:, columns.sensor_places] = True
    if not finite.all():
        i, k = (int(index) for index in np.argwhere(~finite)[0])
        raise table.bad_value(
            channels[k].column,
            rows.written[k][i],
            table.row_place(row + i),
            columns.exclusion(channels[k]),
        )
    return values


def _states(numbers: np.ndarray, written: ColumnValues) -> Float[np.ndarray, " rows"]:
    """Numbers of a state; words such as true and false become 1 and 0."""
    if not isinstance(written, pl.Series) or written.dtype != pl.String:
        return np.asarray(numbers, dtype=np.float64)
    words = written.str.strip_chars().str.to_lowercase()
    states = words.replace_strict(_STATES, default=None, return_dtype=pl.Float64).to_numpy()
    return np.where(np.isnan(states), numbers, states)


def recut(
    arrays: Iterable[Float[np.ndarray, "_ channels"]], size: int, overlap: int = 0
) -> Iterator[Float[np.ndarray, "_ channels"]]:
    """Join arrays and cut them into blocks that advance by `size` and share `overlap` rows.

    The last block is shorter; it is dropped if it has no rows beyond the overlap.
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


def padded(
    segment: Iterable[Float[np.ndarray, "_ _"]], before: int, after: int, columns: Columns
) -> Iterator[Float[np.ndarray, "_ _"]]:
    """Extend a segment by copies of its end rows, with time NaN and weight 0.

    Args:
        segment: evenly spaced rows in blocks: `columns`, at the end a weight or mark per drive.
        before, after: number of rows beyond the first and the last row.
        columns: columns of the rows.
    """
    drives = len(columns.torque)
    blocks = (block for block in segment if len(block))
    last = next(blocks, None)
    if last is None:
        return

    def beyond(row: Float[np.ndarray, "1 _"], times: int) -> Float[np.ndarray, "_ _"]:
        rows = np.repeat(row, times, axis=0)
        rows[:, 0], rows[:, rows.shape[1] - drives :] = np.nan, 0.0
        rows[:, columns.sensor_places] = np.nan
        return rows

    yield beyond(last[:1], before)
    for block in chain([last], blocks):
        last = block
        yield block
    yield beyond(last[-1:], after)
