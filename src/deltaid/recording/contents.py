"""Contents of a recording: columns with the range of their numbers, and a proposed mapping."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaid.errors import DeltaidError, Doubt, RecordingError
from deltaid.recording.mapping import Known, MappingProposal
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.proposed_mapping import Column, addresses, count_drives, proposed_mapping
from deltaid.recording.source import BATCH_ROWS, RENAME, LogTable
from deltaid.recording.table import open_table
from deltaid.recording.time.counts import is_clock
from deltaid.robot.load import RobotLike, load_robot


@dataclass(frozen=True)
class Contents:
    """Contents of a recording.

    Attributes:
        columns: columns with the range of their numbers.
        rows: number of rows.
        proposal: the proposed mapping.
    """

    columns: tuple[Column, ...]
    rows: int
    proposal: MappingProposal


def count_columns(path: str) -> int:
    """Number of columns of a file that may be a recording; only its beginning is read.

    Raises:
        RecordingError: the file cannot be read, or holds no numbers.
    """
    table = open_table(Path(path))
    columns = addresses(table.fields, table.units)
    for column in columns:
        if column.is_date or _with_ranges(table, [column], 1)[0][0].low is not None:
            return len(columns)
    raise RecordingError(
        "holds no column of numbers",
        where=path,
        cure="is it a recording? CSV, Parquet, MATLAB, NumPy, HDF5, TwinCAT or ROS files are",
    )


def columns(
    log: RecordingLike,
    robot: RobotLike | None = None,
    *,
    units: Mapping[str, str] | None = None,
    gear: float | None = None,
    torque_constant: float | None = None,
) -> MappingProposal:
    """Propose which column of a recording is what, by names, units in names, and the numbers.

    Read `reasons` and `doubts`, then give `.mapping` as `columns=`, or `.save` it. Without a
    mapping, a `certain` proposal is used, and the recording's warnings report it.

    Args:
        log: a file, or a recording in memory.
        robot: the robot, whose number and kinds of drives are used; by default, columns determine
            the number of drives, and drives turn.
        units: units by quantity ("torque": "0.0235 N*m"), which override units in names.
        gear: motor revolutions per joint revolution, if columns are of the motors.
        torque_constant: torque constant at the motor [N m/A], for currents.

    Raises:
        RecordingError: the recording cannot be read.
        DescriptionError: the robot does not exist.
    """
    linear = None if robot is None else load_robot(robot).linear_drives
    return read_contents(log, linear, Known(units or {}, gear, torque_constant)).proposal


def read_contents(
    log: RecordingLike, linear: Sequence[bool] | None, known: Known | None = None
) -> Contents:
    """Read all columns of a recording, and propose a mapping.

    Args:
        linear: whether each drive of the robot slides; None without a robot.
        known: units, gear and torque constant that the user states.

    Raises:
        RecordingError: the file cannot be read.
    """
    source = as_source(log)
    table = source.table if isinstance(source, Recording) else open_table(source)
    found_columns, rows = _columns_of(table)
    doubts = (
        Doubt(table.repeated(name), cause="the same name twice", cure=f"{RENAME}: none is read now")
        for name, count in Counter(table.header).items()
        if count > 1
    )
    warnings = tuple(f"{source}: {text}" for text in (*table.warnings, *doubts))
    if linear is None:
        linear = [False] * count_drives(found_columns)
    proposal = proposed_mapping(found_columns, linear, known)
    found = tuple(
        replace(part, doubts=(*part.doubts, *filter(None, map(table.repeated, part.columns))))
        for part in proposal.found
    )
    return Contents(found_columns, rows, replace(proposal, found=found, warnings=warnings))


def proposal_for(table: LogTable, linear: Sequence[bool]) -> MappingProposal:
    """Propose a mapping for an open table by its first rows, or by names alone if these include no
    positions.

    Raises:
        RecordingError: the file cannot be read.
    """
    by_names = proposed_mapping(addresses(table.fields, table.units), linear)
    if "position" in by_names.missing:
        return by_names
    return proposed_mapping(_columns_of(table, BATCH_ROWS)[0], linear)


def _columns_of(table: LogTable, rows: int | None = None) -> tuple[tuple[Column, ...], int]:
    plain = addresses(table.fields, table.units)
    numbers, count = _with_ranges(table, [column for column in plain if not column.is_date], rows)
    ranges = {column.address: column for column in numbers}
    return tuple(ranges.get(column.address, column) for column in plain), count


def _with_ranges(
    table: LogTable, columns: Sequence[Column], most: int | None
) -> tuple[Sequence[Column], int]:
    """Columns with the range of their numbers in at most `most` rows, and the number of rows.

    Columns of different lengths are read one by one; columns that cannot be read have no range.

    Raises:
        RecordingError: none of several columns can be read.
    """
    low, high, count = np.full(len(columns), np.inf), np.full(len(columns), -np.inf), 0
    starts = list[np.ndarray]()
    try:
        for rows in table.rows([column.address for column in columns]) if columns else ():
            if not count:
                pairs = zip(columns, rows.written, strict=True)
                columns = [replace(column, is_date=is_clock(text)) for column, text in pairs]
            numbers = np.array([np.asarray(values, dtype=float) for values in rows.numbers])
            finite = np.isfinite(numbers)
            low = np.minimum(low, numbers.min(axis=1, initial=np.inf, where=finite))
            high = np.maximum(high, numbers.max(axis=1, initial=-np.inf, where=finite))
            starts.append(numbers[:, : max(BATCH_ROWS - count, 0)])
            count += rows.size
            if most is not None and count >= most:
                break
    except DeltaidError:
        if len(columns) == 1:
            return columns, 0
        each = [_with_ranges(table, [column], most) for column in columns]
        if not any(rows for _, rows in each):
            raise
        return [column for (column,), _ in each], next((rows for _, rows in each if rows), 0)
    ranges = zip(
        columns, low.tolist(), high.tolist(), np.hstack(starts or [low[:, None]]), strict=True
    )
    return [replace(c, low=a, high=b, start=s) if a <= b else c for c, a, b, s in ranges], count
