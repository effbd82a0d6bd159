"""What a recording holds: its columns with the range of their numbers, and a proposed mapping."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaid.errors import DeltaidError, RecordingError
from deltaid.recording.proposed_mapping import (
    Column,
    MappingProposal,
    addresses,
    proposed_mapping,
)
from deltaid.recording.source import Table
from deltaid.recording.table import open_table


@dataclass(frozen=True)
class Contents:
    """What a recording holds.

    Attributes:
        columns: with the range of their numbers.
        rows: how many.
        proposal: the mapping that may be right.
        warnings: about the file's layout.
    """

    columns: tuple[Column, ...]
    rows: int
    proposal: MappingProposal
    warnings: tuple[str, ...] = ()


def count_columns(path: str) -> int:
    """How many columns a file has, if it may be a recording; only its beginning is read.

    Raises:
        RecordingError: it cannot be read, or holds no numbers.
    """
    table = open_table(Path(path))
    columns = addresses(table.fields, table.units)
    if any(column.is_date or _begins_with_numbers(table, column.address) for column in columns):
        return len(columns)
    raise RecordingError(
        "holds no column of numbers",
        where=path,
        cure="is it a recording? CSV, Parquet, MATLAB, NumPy, HDF5, TwinCAT or ROS files are",
    )


def read_contents(path: str, linear: Sequence[bool]) -> Contents:
    """All columns of a recording and the mapping that is proposed.

    Args:
        linear: for each drive of the robot whether it slides.

    Raises:
        RecordingError: the file cannot be read.
    """
    table = open_table(Path(path))
    columns = addresses(table.fields, table.units)
    numbers, rows = _with_ranges(table, [column for column in columns if not column.is_date])
    read = {column.address: column for column in numbers}
    columns = tuple(read.get(column.address, column) for column in columns)
    warnings = tuple(str(text) for text in table.warnings)
    return Contents(columns, rows, proposed_mapping(columns, linear), warnings)


def _begins_with_numbers(table: Table, name: str) -> bool:
    try:
        rows = next(iter(table.rows([name])), None)
    except DeltaidError:
        return False
    return rows is not None and bool(np.isfinite(np.asarray(rows.numbers[0], dtype=float)).any())


def _with_ranges(table: Table, columns: Sequence[Column]) -> tuple[Sequence[Column], int]:
    """Columns with the range of their numbers, and the number of rows.

    Columns that do not belong together, such as arrays of other lengths, are read by themselves;
    those that cannot be read stay as they are.
    """
    try:
        return _with_ranges_together(table, columns)
    except DeltaidError:
        if len(columns) == 1:
            return columns, 0
        each = [_with_ranges(table, [column]) for column in columns]
        return [column for (column,), _ in each], next((rows for _, rows in each if rows), 0)


def _with_ranges_together(table: Table, columns: Sequence[Column]) -> tuple[list[Column], int]:
    low, high, count = np.full(len(columns), np.inf), np.full(len(columns), -np.inf), 0
    for rows in table.rows([column.address for column in columns]) if columns else ():
        numbers = [np.asarray(values, dtype=float) for values in rows.numbers]
        finite = [values[np.isfinite(values)] for values in numbers]
        low = np.minimum(low, [values.min(initial=np.inf) for values in finite])
        high = np.maximum(high, [values.max(initial=-np.inf) for values in finite])
        count += len(numbers[0])
    ranges = zip(columns, low.tolist(), high.tolist(), strict=True)
    return [replace(c, low=a, high=b) if a <= b else c for c, a, b in ranges], count
