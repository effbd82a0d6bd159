"""Files of measured poses: which column is what, units, and how well instruments read.

A row has the pose and what the instrument read. The pose is the drives' coordinates q1, q2, …,
or the commanded platform point x, y, z, of which the described robot's inverse kinematics make
them. Of distances both ends have a pose: a_q1, … and b_q1, …, or a_x, … and b_x, …. Read are
px, py, pz of points, the height `block` of what a probe touched above the plane (0 without such a
column), and `distance`.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deltaid.calibration.instruments import KINDS, Instrument
from deltaid.calibration.loops import Loops
from deltaid.errors import KinematicsError, RecordingError
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table
from deltaid.recording.units import si_factor
from deltaid.robot.part import Part, Positive
from deltaid.sensors.planning.offers import PoseKind

# What instruments of each kind usually read to [m]: a good tracker or camera with a tag, a touch
# probe of a printer or mill, a calliper in a steady hand.
_POINT, _TOUCH, _CALLIPER = 2e-5, 1e-5, 2e-5
USUAL: dict[PoseKind, float] = {"points": _POINT, "probe": _TOUCH, "distances": _CALLIPER}
_READ: dict[PoseKind, tuple[str, ...]] = {
    "points": ("px", "py", "pz"), "probe": ("block",), "distances": ("distance",),
}  # fmt: skip
# Units that people forget to state: how many make a metre.
NAMED_UNITS = {1e3: "mm", 39.37: "inch", 100.0: "cm"}
# A rotary drive turns less than this within its workspace [rad]; more are degrees.
_WIDE = 2 * np.pi
# What comes back of a point by the described robot's drives is this near to it [m].
_CLOSED = 1e-6
# Readings of a file: a tracker's ten minutes at 30 Hz; a fit of many more takes minutes.
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


class Measurements(Part):
    """Which column of measured poses is what, by kind of instrument."""

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
    """The readings of one file or table, in SI units.

    Raises:
        RecordingError: the file is of another instrument; a column is missing, or a number is;
            there are no rows, or too many; drives look like degrees, or poses are out of reach.
    """
    source = as_source(given, kind)
    table = source.table if isinstance(source, Recording) else open_table(source)
    if kind == "probe" and set(_READ["points"]) <= set(table.header):
        raise RecordingError(
            "has px, py, pz: these are points, no touches",
            where=str(table.path),
            cure="give the file with --points",
        )
    where, length = str(table.path), si_factor(columns.unit, "m", where=f"{kind}.unit")
    values = [
        _column(table, columns, name, length)
        for name in _READ[kind]
        if name != "block" or columns.columns.get(name, name) in table.header
    ]
    ends = ("a_", "b_") if kind == "distances" else ("",)
    q = np.stack([_drives(table, columns, end, loops, length) for end in ends], axis=1)
    if not len(q):
        raise RecordingError("has no rows", where=where, cure="give at least one measured pose")
    read_values = np.column_stack(values) if values else np.zeros((len(q), 1))
    noise = USUAL[kind] if columns.noise is None else columns.noise * length
    return KINDS[kind](where, q, read_values, noise, table.first_row + np.arange(len(q)))


def _drives(
    table: LogTable, columns: InstrumentColumns, end: str, loops: Loops, length: float
) -> Float[np.ndarray, "rows drives"]:
    """Drive coordinates of one end of each row."""
    names = [f"{end}q{i + 1}" for i in range(loops.limbs)]
    linear = loops.kinematics.robot.is_linear("drive1")
    where = str(table.path)
    if columns.columns.get(names[0], names[0]) not in table.header and (
        columns.columns.get(f"{end}x", f"{end}x") in table.header
    ):
        x = np.column_stack([_column(table, columns, f"{end}{axis}", length) for axis in "xyz"])
        q = _inverse(x, loops, where)
        far = np.linalg.norm(loops.start(q)[:, :3] - x, axis=1)
        other = np.flatnonzero(~(far < _CLOSED))
        if other.size:
            raise RecordingError(
                "the described robot does not stand at this point",
                where=table.row_place(table.first_row + int(other[0])),
                cure="z points up, so most robots work below zero; check signs and axes of x, y, z",
            )
        return q
    target = "m" if linear else "rad"
    factor = si_factor(columns.drive_unit or target, target, where="drive_unit")
    q = np.column_stack([_column(table, columns, name, factor) for name in names])
    far = np.argwhere(np.abs(q) > _WIDE)
    if not linear and far.size and columns.drive_unit is None:
        raise RecordingError(
            f"column {names[far[0, 1]]} reaches {q[tuple(far[0])]:.4g} rad; likely degrees",
            where=table.row_place(table.first_row + int(far[0, 0])),
            cure="say so: drive_unit: deg under this instrument, with --columns FILE.yaml",
        )
    open_ = np.flatnonzero(~np.isfinite(loops.start(q)).all(axis=1))
    if open_.size:
        raise RecordingError(
            "the described robot cannot stand at these drive positions",
            where=table.row_place(table.first_row + int(open_[0])),
            cure="check the drives' unit, sign, zero and order, and the description's lengths",
        )
    return q


def _inverse(
    x: Float[np.ndarray, "rows 3"], loops: Loops, where: str
) -> Float[np.ndarray, "rows drives"]:
    """Drive coordinates at commanded points."""
    try:
        return loops.inverse(x)
    except KinematicsError as error:
        what = f"{error.where}: {error.what}"
    for factor, unit in NAMED_UNITS.items():
        try:
            loops.inverse(x / factor)
        except KinematicsError:
            continue
        what = f"x, y, z are out of reach, and within it in {unit}; likely they are in {unit}"
        break
    raise RecordingError(
        what,
        where=where,
        cure="x, y, z are the commanded platform point in the robot's frame; give "
        "their unit with --columns FILE.yaml if it is not m",
    )


def _column(
    table: LogTable, columns: InstrumentColumns, name: str, factor: float
) -> Float[np.ndarray, " rows"]:
    """One column in SI units."""
    column = columns.columns.get(name, name)
    if column not in table.header:
        raise RecordingError(
            f"has no column {column}; its columns are {', '.join(table.header[:12])}",
            where=table.header_place,
            cure=f"rename it to {name}, or name it under columns with --columns FILE.yaml"
            + (f"; or give {name[:-2]}x, {name[:-2]}y, {name[:-2]}z" if name[-2:] == "q1" else ""),
        )
    read_rows = [
        (np.asarray(piece.numbers[0], dtype=float), piece.written[0])
        for piece in table.rows([column])
    ]
    numbers = np.concatenate([part for part, _ in read_rows] or [np.zeros(0)])
    if len(numbers) > _MOST:
        raise RecordingError(
            f"has {len(numbers)} readings; at most {_MOST} are fitted",
            where=str(table.path),
            cure="keep some hundred that are spread over the workspace",
        )
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        written = [text for _, part in read_rows for text in part]
        place = table.row_place(table.first_row + int(bad[0]))
        raise table.bad_value(column, written[bad[0]], place)
    return numbers * factor
