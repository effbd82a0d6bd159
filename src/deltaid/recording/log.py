"""A log as a whole: surveyed once for what it holds and what is wrong with it, then read again."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import SINGULAR_CONDITION, Kinematics
from deltaid.recording.columns import ColumnMapping, Columns, resolve_columns
from deltaid.recording.filter import SpectrumEstimate
from deltaid.recording.table import Batch, Table, checksum, open_table, read_batches
from deltaid.robot.description import RobotDescription

# A time step this much longer than the usual one is a gap; one this far off it is jitter.
_GAP, _JITTER = 1.5, 0.05
# No rotary arm of a Delta turns half a revolution; numbers beyond this are degrees.
_LARGEST_ARM_ANGLE = np.pi


@dataclass(frozen=True)
class Log:
    """A surveyed recording.

    Attributes:
        table, columns: the file, and which of its columns are what.
        sha256: checksum of the file.
        samples: number of rows.
        rate: sampling rate, from the median time step [Hz].
        torque_max: largest |τ| of each drive [N m]; empty without torques.
        suggested_cutoff: low-pass cut-off by the rule of `SpectrumEstimate.cutoff` [Hz].
        warnings: what is doubtful, with rows and columns.
    """

    table: Table
    columns: Columns
    sha256: str
    samples: int
    rate: float
    torque_max: Float[np.ndarray, " drives"]
    suggested_cutoff: float | None
    warnings: tuple[str, ...]

    @property
    def path(self) -> Path:
        """Where the log is."""
        return self.table.path

    @property
    def has_derivatives(self) -> bool:
        """Whether velocities and accelerations are recorded."""
        return bool(self.columns.velocity and self.columns.acceleration)

    def batches(self) -> Iterator[Batch]:
        """All rows in SI units."""
        return read_batches(self.table, self.columns)


def open_log(
    path: Path,
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    *,
    need_torque: bool = True,
) -> Log:
    """Survey a recording: read every row once and check it, before anything is computed from it.

    Raises:
        RecordingError: a column is missing; a value is missing or not finite; time runs backwards
            or has gaps; a torque is constant; angles look like degrees; a sample is out of reach.
    """
    table = open_table(path)
    columns = resolve_columns(table.header, kinematics.dof, mapping, where=str(path))
    if need_torque and not columns.torque:
        raise RecordingError(
            f"has no torque columns; its columns are {', '.join(table.header)}",
            where=str(path),
            cure="name them tau1, tau2, … or declare them with --columns MAPPING.yaml",
        )
    survey = _Survey(table, columns, kinematics)
    for batch in read_batches(table, columns):
        survey.add(batch)
    return survey.result()


@dataclass
class _Survey:
    """Running state of the first pass over a log."""

    table: Table
    columns: Columns
    kinematics: Kinematics
    samples: int = 0
    step: float = 0.0
    last_time: float = np.nan
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    outside: int = 0
    jitter: int = 0
    first_outside: str = ""
    first_jitter: str = ""
    warnings: list[str] = field(default_factory=list)
    spectrum: SpectrumEstimate = field(init=False)

    def __post_init__(self) -> None:
        self.spectrum = SpectrumEstimate(self.kinematics.dof)

    def add(self, batch: Batch) -> None:
        values = batch.values
        self._check_time(batch)
        low, high = values.min(axis=0), values.max(axis=0)
        self.low = low if self.low is None else np.minimum(self.low, low)
        self.high = high if self.high is None else np.maximum(self.high, high)
        q = values[:, 1 : 1 + self.kinematics.dof]
        self._check_angles(q, batch.row)
        self._check_reach(q, batch.row)
        self.spectrum.add(q)
        self.samples += len(values)

    def result(self) -> Log:
        where = str(self.table.path)
        if self.samples < 2 or self.low is None or self.high is None:
            raise RecordingError("has fewer than two rows of data", where=where)
        self._check_constant(self.low, self.high)
        if self.outside:
            self.warnings.append(
                f"{self.outside} samples lie outside the workspace of the description, the first "
                f"in {self.first_outside}"
            )
        if self.jitter:
            self.warnings.append(
                f"{self.jitter} time steps differ by more than {100 * _JITTER:.0f} % from the "
                f"usual {self.step:g} s, the first in {self.first_jitter}; taken as evenly spaced"
            )
        n = len(self.columns.torque)
        torque_max = np.maximum(np.abs(self.low), np.abs(self.high))[len(self.low) - n :]
        rate = 1.0 / self.step
        return Log(
            table=self.table,
            columns=self.columns,
            sha256=checksum(self.table.path),
            samples=self.samples,
            rate=rate,
            torque_max=torque_max,
            suggested_cutoff=self.spectrum.cutoff(rate),
            warnings=tuple(self.warnings),
        )

    def _check_time(self, batch: Batch) -> None:
        steps = np.diff(batch.values[:, 0], prepend=self.last_time)
        known = steps[~np.isnan(steps)]
        if not self.step and known.size:
            self.step = float(np.median(known))
        self.last_time = float(batch.values[-1, 0])
        bad = np.flatnonzero(steps <= 0)
        if bad.size:
            i = bad[0]
            raise RecordingError(
                f"time does not increase: {batch.values[i, 0]:g} s comes after "
                f"{batch.values[i, 0] - steps[i]:g} s",
                where=self._row(batch.row + i),
                cure="sort the rows, drop repeated ones, or split the log where it restarts",
            )
        gaps = np.flatnonzero(steps > _GAP * self.step)
        if gaps.size:
            i = gaps[0]
            raise RecordingError(
                f"there is a gap of {steps[i]:g} s where {self.step:g} s is usual",
                where=self._row(batch.row + i),
                cure="split the log at the gap and give both parts as separate logs",
            )
        uneven = np.flatnonzero(np.abs(steps - self.step) > _JITTER * self.step)
        if uneven.size and not self.jitter:
            self.first_jitter = f"row {batch.row + uneven[0]}"
        self.jitter += uneven.size

    def _check_angles(self, q: Float[np.ndarray, "rows dof"], row: int) -> None:
        limbs = len(self.kinematics.robot.limbs.azimuth_deg)
        large = np.argwhere(np.abs(q[:, :limbs]) > _LARGEST_ARM_ANGLE)
        if large.size:
            i, drive = large[0]
            name = self.columns.position[drive].column
            raise RecordingError(
                f"column {name} is {q[i, drive]:.4g} rad, more than half a revolution; it looks "
                "like degrees, or like the motor side of a gear",
                where=self._row(row + i),
                cure="declare its unit and gear with --columns MAPPING.yaml "
                f"(position: - {{column: {name}, unit: deg, gear: 1}})",
            )

    def _check_reach(self, q: Float[np.ndarray, "rows dof"], row: int) -> None:
        z, margin = self.kinematics.forward_unchecked(q)
        bad = np.flatnonzero(~(margin > 0))
        if bad.size:
            i = bad[0]
            angles = ", ".join(f"{value:.4g}" for value in q[i])
            raise RecordingError(
                f"no platform position closes the loops at q = [{angles}] rad",
                where=self._row(row + i),
                cure="check sign, zero and order of the drives (angle 0 = arm horizontal and "
                "outwards, positive = down) and the robot's lengths",
            )
        condition = self.kinematics.condition(z)
        singular = np.flatnonzero(~(condition < SINGULAR_CONDITION))
        if singular.size:
            raise RecordingError(
                "the robot is in a singular pose", where=self._row(row + singular[0])
            )
        outside = np.flatnonzero(~inside_workspace(self.kinematics.robot, z))
        if outside.size and not self.outside:
            i = outside[0]
            self.first_outside = f"row {row + i} at [{z[i, 0]:.3f}, {z[i, 1]:.3f}, {z[i, 2]:.3f}] m"
        self.outside += outside.size

    def _check_constant(
        self, low: Float[np.ndarray, " channels"], high: Float[np.ndarray, " channels"]
    ) -> None:
        constant = [c.column for c, a, b in zip(self.columns.all, low, high, strict=True) if a == b]
        torque = {channel.column for channel in self.columns.torque}
        for name in constant:
            if name in torque:
                raise RecordingError(
                    f"column {name} is constant; no torque was recorded",
                    where=str(self.table.path),
                    cure="check the logger's signal, or map the right column with --columns",
                )
            self.warnings.append(
                f"column {name} is constant: that drive does not move, so what only it shows "
                "stays undetermined"
            )

    def _row(self, row: int) -> str:
        return f"{self.table.path}, row {row}"


def inside_workspace(
    robot: RobotDescription, z: Float[np.ndarray, "samples dof"]
) -> Bool[np.ndarray, " samples"]:
    """Whether platform points lie in the described workspace, one truth value a sample."""
    low, high = robot.workspace.z
    radius = np.hypot(z[:, 0], z[:, 1])
    return (radius <= robot.workspace.radius) & (z[:, 2] >= low) & (z[:, 2] <= high)
