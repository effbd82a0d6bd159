"""Measured poses in files and tables: their columns, units and numbers.

A row of a file has a pose and a reading. The pose is given by drive coordinates q1, q2, …, or by
the commanded platform point x, y, z, through the described robot's inverse kinematics. Distances
have two poses: a_q1, … and b_q1, …, or a_x, … and b_x, …. Readings are px, py, pz of points, the
height `block` of the touched surface above the plane (default 0), and `distance`.
"""

from collections.abc import Sequence
from contextlib import suppress
from itertools import chain, combinations
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deltaid.calibration.loops import Loops
from deltaid.calibration.readings import KINDS, NAMED_UNITS, Instrument, PointReadings
from deltaid.calibration.unknowns import TOLERANCE
from deltaid.errors import KinematicsError, RecordingError, unknown
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table
from deltaid.recording.units import si_factor
from deltaid.robot.part import LARGEST, Part, Positive
from deltaid.sensors.planning.offers import PoseKind

# Largest angle of an arm [rad]; larger numbers are likely degrees.
_WIDE = 2 * np.pi
# Most readings of a file: a tracker's ten minutes at 30 Hz; more take minutes to fit.
_MOST = 20_000

# Files or tables of one kind of instrument, one or several.
ReadingsLike = RecordingLike | Sequence[RecordingLike]


class InstrumentColumns(Part):
    """Columns of one kind of instrument."""

    noise: Positive | None = Field(
        default=None, description="standard deviation of what is read, in `unit`"
    )
    unit: str = Field(default="m", description="of lengths and points, such as mm")
    drive_unit: str | None = Field(
        default=None, description="of q1, q2, …: rad or m by default, such as deg"
    )
    columns: dict[str, Annotated[str, Field(min_length=1)]] = Field(
        default_factory=dict[str, str],
        description="names in the file of q1 or x, a_q1, px, block, distance, …",
    )

    def has(self, name: str, table: LogTable) -> bool:
        return self.columns.get(name, name) in table.header


class Measurements(Part):
    """Columns of measured poses, by kind of instrument."""

    points: InstrumentColumns = Field(default=InstrumentColumns(), description="3-D points")
    probe: InstrumentColumns = Field(default=InstrumentColumns(), description="touches of a plane")
    distances: InstrumentColumns = Field(
        default=InstrumentColumns(), description="between two poses each"
    )
    torques: ColumnMapping | None = Field(
        default=None, description="of recordings, as the mapping file of identify"
    )


def read(
    kind: PoseKind, given: RecordingLike, columns: InstrumentColumns, loops: Loops
) -> Instrument:
    """Readings of one file or table, in SI units. Raises a RecordingError where it is of another
    instrument, a column or number is missing, it has no rows or too many, drives look like
    degrees, or poses are out of reach."""
    source, instrument = as_source(given, kind), KINDS[kind]
    table = source.table if isinstance(source, Recording) else open_table(source)
    if kind == "probe" and set(PointReadings.read) <= set(table.header):
        raise RecordingError(
            "has px, py, pz: these are points, no touches",
            where=str(table.path),
            cure="give the file with --points",
        )
    ends = ("a_", "b_") if kind == "distances" else ("",)
    drives = [[f"{end}q{i + 1}" for i in range(loops.limbs)] for end in ends]
    points = [[f"{end}{axis}" for axis in "xyz"] for end in ends]
    _require_names(columns, (list(instrument.read), *drives, *points), f"{kind}.columns")
    cure = "lengths are in m, mm, inch or the like"
    where, length = str(table.path), si_factor(columns.unit, "m", where=f"{kind}.unit", cure=cure)
    needed = [name for name in instrument.read if name != "block" or columns.has(name, table)]
    values = [_column(table, columns, name, ("m", length)) for name in needed]
    q = np.stack(
        [
            _drives(table, columns, names, loops, length)
            for names in zip(drives, points, strict=True)
        ],
        axis=1,
    )
    if not len(q):
        raise RecordingError("has no rows", where=where, cure="give at least one measured pose")
    read_values = np.column_stack(values) if values else np.zeros((len(q), 1))
    return instrument(
        source=where,
        q=q,
        values=read_values,
        noise=instrument.usual if columns.noise is None else columns.noise * length,
        rows=table.first_row + np.arange(len(q)),
    )


def _require_names(columns: InstrumentColumns, groups: Sequence[Sequence[str]], where: str) -> None:
    """Raise a DeltaidError for an unknown key, or for two keys that name one column."""
    for name in columns.columns:
        if not any(name in group for group in groups):
            raise unknown(name, chain(*groups), "column", where)
    for name, other in chain(*(combinations(group, 2) for group in groups)):
        column = columns.columns.get(name, name)
        if column == columns.columns.get(other, other):
            raise RecordingError(
                f"{name} and {other} are one column, {column}",
                where=where,
                cure="name the column of each",
            )


def _drives(
    table: LogTable,
    columns: InstrumentColumns,
    pose: tuple[Sequence[str], Sequence[str]],
    loops: Loops,
    length: float,
) -> Float[np.ndarray, "rows drives"]:
    (names, point), linear = pose, loops.is_linear
    if not columns.has(names[0], table) and columns.has(point[0], table):
        x = np.column_stack([_column(table, columns, name, ("m", length)) for name in point])
        q = _inverse(x, loops, table)
        bad = ~(np.linalg.norm(loops.start(q)[:, :3] - x, axis=1) < TOLERANCE)
        what = "the described robot does not stand at this point"
        cure = "z points up, so most robots work below zero; check signs and axes of x, y, z"
    else:
        target = "m" if linear else "rad"
        factor = si_factor(columns.drive_unit or target, target, where="drive_unit")
        q = np.column_stack([_column(table, columns, name, (target, factor)) for name in names])
        if not linear and columns.drive_unit is None:
            _require_radians(table, names, q)
        bad = ~np.isfinite(loops.start(q)).all(axis=1)
        what = "the described robot cannot stand at these drive positions"
        cure = "check the drives' unit, sign, zero and order, and the description's lengths"
    if bad.any():
        raise RecordingError(
            what, where=table.row_place(table.first_row + int(bad.argmax())), cure=cure
        )
    return q


def _require_radians(
    table: LogTable, names: Sequence[str], q: Float[np.ndarray, "rows drives"]
) -> None:
    for row, drive in np.argwhere(np.abs(q) > _WIDE)[:1].tolist():
        what, cure = "likely degrees", "say so: drive_unit: deg"
        if np.abs(q).max() > np.degrees(_WIDE):
            what, cure = "more than an arm turns", "repair the row, or state the unit: drive_unit"
        raise RecordingError(
            f"column {names[drive]} reaches {q[row, drive]:.4g} rad; {what}",
            where=table.row_place(table.first_row + row),
            cure=f"{cure} under this instrument, with --columns FILE.yaml",
        )


def _inverse(
    x: Float[np.ndarray, "rows 3"], loops: Loops, table: LogTable
) -> Float[np.ndarray, "rows drives"]:
    with suppress(KinematicsError):
        return loops.inverse(x)
    what, where = "", str(table.path)
    for factor, unit in NAMED_UNITS.items():
        with suppress(KinematicsError):
            loops.inverse(x / factor)
            what = f"x, y, z are out of reach, and within it in {unit}; likely they are in {unit}"
            break
    else:
        for row, point in enumerate(x, table.first_row):
            try:
                loops.inverse(point[None])
            except KinematicsError as error:
                what, where = error.what, table.row_place(row)
                break
    raise RecordingError(
        what,
        where=where,
        cure="x, y, z are the commanded platform point in the robot's frame; give "
        "their unit with --columns FILE.yaml if it is not m",
    )


def _column(
    table: LogTable, columns: InstrumentColumns, name: str, unit: tuple[str, float]
) -> Float[np.ndarray, " rows"]:
    """Numbers of a column in SI; `unit` is the SI unit and the factor to it."""
    column, (si, factor) = columns.columns.get(name, name), unit
    if column not in table.header:
        raise RecordingError(
            f"has no column {column}; its columns are {', '.join(table.header[:12])}",
            where=table.header_place,
            cure=f"rename it to {name}, or name it under columns with --columns FILE.yaml"
            + (f"; or give {name[:-2]}x, {name[:-2]}y, {name[:-2]}z" if name[-2:] == "q1" else ""),
        )
    pieces = [(np.asarray(x.numbers[0], dtype=float), x.written[0]) for x in table.rows([column])]
    numbers = np.concatenate([part for part, _ in pieces] or [np.zeros(0)])
    if len(numbers) > _MOST:
        raise RecordingError(
            f"has {len(numbers)} readings; at most {_MOST} are fitted",
            where=str(table.path),
            cure="keep some hundred that are spread over the workspace",
        )
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        written = [text for _, part in pieces for text in part]
        raise table.bad_value(
            column, written[bad[0]], table.row_place(table.first_row + int(bad[0]))
        )
    huge = np.flatnonzero(np.abs(numbers) > LARGEST / factor)
    if huge.size:
        raise RecordingError(
            f"column {column} is {numbers[huge[0]] * factor:.4g} {si}, which cannot be",
            where=table.row_place(table.first_row + int(huge[0])),
            cure="remove or repair such rows",
        )
    return numbers * factor
