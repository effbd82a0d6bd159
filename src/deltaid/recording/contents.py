"""What a recording holds: its columns with the range of their numbers, and a proposed mapping."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaid.errors import DeltaidError, RecordingError
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.proposed_mapping import (
    Column,
    MappingProposal,
    addresses,
    count_drives,
    proposed_mapping,
)
from deltaid.recording.source import Table
from deltaid.recording.table import open_table
from deltaid.robot.load import RobotLike, described


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


def columns(log: RecordingLike, robot: RobotLike | None = None) -> MappingProposal:
    """Propose which column of a recording is what, by names, units and sizes of its numbers.

    Nothing is used unasked: read the reasons, then give `.mapping` as `columns=`, or `.save` it.

    Args:
        log: a file, or a recording in memory.
        robot: whose drives are sought; without one, as many as the positions are numbered.

    Raises:
        RecordingError: the recording cannot be read.
        DescriptionError: there is no such robot.
    """
    if robot is None:
        return read_contents(log, None).proposal
    description = described(robot)
    linear = [description.is_linear(drive) for drive in description.drives]
    return read_contents(log, linear).proposal


def read_contents(log: RecordingLike, linear: Sequence[bool] | None) -> Contents:
    """All columns of a recording and the mapping that is proposed.

    Args:
        linear: for each drive of the robot whether it slides; None where no robot is known.

    Raises:
        RecordingError: the file cannot be read.
    """
    source = as_source(log)
    table = source.table if isinstance(source, Recording) else open_table(source)
    plain = addresses(table.fields, table.units)
    numbers, rows = _with_ranges(table, [column for column in plain if not column.is_date])
    read = {column.address: column for column in numbers}
    found = tuple(read.get(column.address, column) for column in plain)
    warnings = tuple(str(text) for text in table.warnings)
    if linear is None:
        linear = [False] * count_drives(found)
    return Contents(found, rows, proposed_mapping(found, linear), warnings)


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
