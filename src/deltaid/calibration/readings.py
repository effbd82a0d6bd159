"""Measured poses: readings of instruments, their slopes and unknowns, and their files.

Points      m = R x + t of a tracker or camera, whose frame (R, t) is unknown
Probe       z − (h + a x + b y + block) = 0 on a plane of unknown height and slopes, bare or on
            blocks of known height
Distances   |x_A − x_B| of a calliper or ballbar

A row of a file has a pose and a reading. The pose is given by drive coordinates q1, q2, …, or by
the commanded platform point x, y, z, through the described robot's inverse kinematics. Distances
have two poses: a_q1, … and b_q1, …, or a_x, … and b_x, …. Readings are px, py, pz of points, the
height `block` of the touched surface above the plane (default 0), and `distance`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field
from scipy.spatial.transform import Rotation

from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import TOLERANCE
from deltaid.errors import KinematicsError, RecordingError
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table
from deltaid.recording.units import si_factor
from deltaid.robot.part import Part, Positive
from deltaid.sensors.planning.offers import PoseKind

# Units that users often forget to state: how many make a metre.
NAMED_UNITS = {1e3: "mm", 39.37: "inch", 100.0: "cm"}
# Larger drive angles [rad] are degrees.
_WIDE = 2 * np.pi
# Most readings of a file: a tracker's ten minutes at 30 Hz; more take minutes to fit.
_MOST = 20_000

# Files or tables of one kind of instrument, one or several.
ReadingsLike = RecordingLike | Sequence[RecordingLike]
Points = Float[np.ndarray, "rows 3"]
Tools = Float[np.ndarray, "rows ends 3"]
# Measured minus predicted [m], slopes of the prediction by the tool points of all ends, and by the
# instrument's unknowns.
Slopes = tuple[Float[np.ndarray, "rows values"], Float[np.ndarray, "rows values coordinates"],
               Float[np.ndarray, "rows values own"]]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Instrument(ABC):
    """Readings of one session: drive coordinates of each end [rad or m], values of the columns
    `read`, their standard deviation [m] (`usual` by default), and rows of the file."""

    kind: ClassVar[PoseKind]
    readings: ClassVar[str]
    read: ClassVar[tuple[str, ...]]
    usual: ClassVar[float]
    unknowns: ClassVar[tuple[str, ...]] = ()
    source: str
    q: Float[np.ndarray, "rows ends drives"]
    values: Float[np.ndarray, "rows values"]
    noise: float
    rows: Int[np.ndarray, " rows"]

    @cached_property
    def numbers(self) -> Float[np.ndarray, "rows numbers"]:
        return np.hstack([self.q.reshape(len(self.q), -1), self.values])

    @cached_property
    def repeats(self) -> Int[np.ndarray, " rows"]:
        """For each reading, the first one with identical numbers."""
        _, first, which = np.unique(self.numbers, axis=0, return_index=True, return_inverse=True)
        return first[which.ravel()]

    @property
    def is_first(self) -> Bool[np.ndarray, " rows"]:
        return self.repeats == np.arange(len(self.repeats))

    @abstractmethod
    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        """A state of the instrument's unknowns that fits the tool points of its used readings."""

    @abstractmethod
    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        """Errors and slopes at tool points."""

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        """The state after a step of the unknowns."""
        return state + by


class PointReadings(Instrument):
    """3-D points, of a good tracker or camera with a tag; the state is a 3 × 4 matrix [R t]."""

    kind = readings = "points"
    read, usual = ("px", "py", "pz"), 2e-5
    unknowns = ("frame turn x", "frame turn y", "frame turn z", "frame x", "frame y", "frame z")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return aligned(x[used, 0], self.values[used])

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        R, t = state[:, :3], state[:, 3]
        turned = x[:, 0] @ R.T
        turns = np.stack([np.cross(axis, turned) for axis in np.eye(3)], axis=2)
        shifts, R = (np.broadcast_to(part, (len(x), 3, 3)) for part in (np.eye(3), R))
        return self.values - turned - t, R, np.concatenate([turns, shifts], axis=2)

    def moved(self, state: np.ndarray, by: Float[np.ndarray, " own"]) -> np.ndarray:
        turn = Rotation.from_rotvec(by[:3]).as_matrix()
        return np.column_stack([turn @ state[:, :3], state[:, 3] + by[3:]])


class ProbeReadings(Instrument):
    """Contacts with a plane, of a printer's or mill's touch probe; values are the heights of blocks
    on it. The state is h, a, b."""

    kind = "probe"
    readings = "touches"
    read, usual = ("block",), 1e-5
    unknowns = ("plane height", "plane slope x", "plane slope y")

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        A, height = np.insert(x[used, 0, :2], 0, 1.0, axis=1), x[used, 0, 2]
        return np.linalg.lstsq(A, height - self.values[used, 0], rcond=None)[0]

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        A = np.insert(x[:, 0, :2], 0, 1.0, axis=1)
        error = A @ state + self.values[:, 0] - x[:, 0, 2]
        across = np.broadcast_to([-state[1], -state[2], 1.0], (len(A), 1, 3))
        return error[:, None], across, -A[:, None, :]


class DistanceReadings(Instrument):
    """Distances between two tool points each, by calliper or ballbar."""

    kind = readings = "distances"
    read, usual = ("distance",), 2e-5

    def start(self, x: Tools, used: np.ndarray | slice = slice(None)) -> np.ndarray:
        return np.zeros(0)

    def slopes(self, x: Tools, state: np.ndarray) -> Slopes:
        length = lengths(x)[:, None]
        along, none = ((x[:, 1] - x[:, 0]) / length)[:, None, :], np.zeros((len(x), 1, 0))
        return self.values - length, np.concatenate([-along, along], axis=2), none


def lengths(x: Tools) -> Float[np.ndarray, " rows"]:
    """Distances between both ends of each row [m]."""
    return np.linalg.norm(x[:, 1] - x[:, 0], axis=1)


KINDS: dict[PoseKind, type[Instrument]] = {
    "points": PointReadings, "probe": ProbeReadings, "distances": DistanceReadings,
}  # fmt: skip


def aligned(x: Points, m: Points, mirrored: bool = False) -> Float[np.ndarray, "3 4"]:
    """[R t] of least squares with m ≈ R x + t (Kabsch 1976), R a reflection where mirrored."""
    mean_x, mean_m = x.mean(axis=0), m.mean(axis=0)
    U, _, Vt = np.linalg.svd((m - mean_m).T @ (x - mean_x))
    sign = np.sign(np.linalg.det(U @ Vt)) * (-1.0 if mirrored else 1.0)
    R = U @ np.diag([1.0, 1.0, sign]) @ Vt
    return np.column_stack([R, mean_m - R @ mean_x])


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
    instrument, a column or number is missing, there are no rows or too many, drives look like
    degrees, or poses are out of reach."""
    source, instrument = as_source(given, kind), KINDS[kind]
    table = source.table if isinstance(source, Recording) else open_table(source)
    if kind == "probe" and set(PointReadings.read) <= set(table.header):
        raise RecordingError(
            "has px, py, pz: these are points, no touches",
            where=str(table.path),
            cure="give the file with --points",
        )
    where, length = str(table.path), si_factor(columns.unit, "m", where=f"{kind}.unit")
    needed = [name for name in instrument.read if name != "block" or columns.has(name, table)]
    values = [_column(table, columns, name, length) for name in needed]
    ends = ("a_", "b_") if kind == "distances" else ("",)
    q = np.stack([_drives(table, columns, end, loops, length) for end in ends], axis=1)
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


def _drives(
    table: LogTable, columns: InstrumentColumns, end: str, loops: Loops, length: float
) -> Float[np.ndarray, "rows drives"]:
    names, linear = [f"{end}q{i + 1}" for i in range(loops.limbs)], loops.is_linear
    if not columns.has(names[0], table) and columns.has(f"{end}x", table):
        x = np.column_stack([_column(table, columns, f"{end}{axis}", length) for axis in "xyz"])
        q = _inverse(x, loops, str(table.path))
        bad = ~(np.linalg.norm(loops.start(q)[:, :3] - x, axis=1) < TOLERANCE)
        what = "the described robot does not stand at this point"
        cure = "z points up, so most robots work below zero; check signs and axes of x, y, z"
    else:
        target = "m" if linear else "rad"
        factor = si_factor(columns.drive_unit or target, target, where="drive_unit")
        q = np.column_stack([_column(table, columns, name, factor) for name in names])
        wide = np.argwhere(np.abs(q) > _WIDE)
        if not linear and wide.size and columns.drive_unit is None:
            raise RecordingError(
                f"column {names[wide[0, 1]]} reaches {q[tuple(wide[0])]:.4g} rad; likely degrees",
                where=table.row_place(table.first_row + int(wide[0, 0])),
                cure="say so: drive_unit: deg under this instrument, with --columns FILE.yaml",
            )
        bad = ~np.isfinite(loops.start(q)).all(axis=1)
        what = "the described robot cannot stand at these drive positions"
        cure = "check the drives' unit, sign, zero and order, and the description's lengths"
    if bad.any():
        raise RecordingError(
            what, where=table.row_place(table.first_row + int(bad.argmax())), cure=cure
        )
    return q


def _inverse(
    x: Float[np.ndarray, "rows 3"], loops: Loops, where: str
) -> Float[np.ndarray, "rows drives"]:
    what = ""
    for factor, unit in ({1.0: ""} | NAMED_UNITS).items():
        try:
            q = loops.inverse(x / factor)
        except KinematicsError as error:
            what = what or f"{error.where}: {error.what}"
            continue
        if not unit:
            return q
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
    column = columns.columns.get(name, name)
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
    return numbers * factor
