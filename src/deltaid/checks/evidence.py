"""Input of checks: a robot, a recording as far as it is readable, its mapping, and corrected
entries of the mapping."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import Doubt, IdentificationError, RecordingError
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import Study, studied
from deltaid.model.record import Settings
from deltaid.model.verdict import Proposal
from deltaid.recording.columns import Columns
from deltaid.recording.mapped_columns import QUANTITIES, AllDrives, DriveColumn, Quantity
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording as InMemory
from deltaid.recording.memory import RecordingLike, as_source
from deltaid.recording.opening import resolved_table
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.recording.source import LogTable
from deltaid.recording.survey_checks import ENCODER_NOISE
from deltaid.recording.table import read_batches, recut
from deltaid.recording.time.grid import usual_step
from deltaid.recording.units import SI_UNITS
from deltaid.robot.description import RobotDescription

# Unit whose numbers are those of another unit times a factor.
_UNITS = {
    ("rad", np.pi / 180): "deg",
    ("rad", 2 * np.pi): "rev",
    ("deg", 180 / np.pi): "rad",
    ("m", 1e-3): "mm",
    ("mm", 1e3): "m",
    ("rad/s", np.pi / 30): "rpm",
    ("rad/s", np.pi / 180): "deg/s",
    ("rpm", 30 / np.pi): "rad/s",
    ("deg/s", 180 / np.pi): "rad/s",
    ("m/s", 1e-3): "mm/s",
    ("mm/s", 1e3): "m/s",
    ("N m", 1e-3): "mN*m",
    ("N*m", 1e-3): "mN*m",
    ("N", 1e-3): "mN",
}
# Most rows that hypotheses are tried on: enough for any motion, few enough for a hundred trials.
_MOST = 1 << 18
# Largest usable number: squares of the slopes of larger ones may overflow.
_OVERFLOWS = np.finfo(float).max ** 0.25
# Ratio to the described quantity from which a quantity is wrong.
WRONG_SCALE = 4.0
# Correlation with the expected signal below which a column holds another signal.
UNRELATED = 0.2

# New values of keys of entries, by drive.
Values = dict[int, dict[str, object]]


@dataclass(frozen=True, eq=False)
class RawRows:
    """Consecutive mapped rows before any check, in SI units; q̇ and τ have no columns where they are
    not recorded."""

    time: Float[np.ndarray, " rows"]
    q: Float[np.ndarray, "rows drives"]
    qd: Float[np.ndarray, "rows _"]
    tau: Float[np.ndarray, "rows _"]

    @property
    def step(self) -> float:
        """Median time between two rows, or the usual one where most rows share stamps [s]."""
        return float(np.median(np.diff(self.time))) or usual_step(self.time)[0]


@dataclass(frozen=True, eq=False)
class Evidence:
    """A robot as described and one recording of it, with its mapping as given.

    Attributes:
        settings: of the fit that is judged.
        problem: that fit, where it exists already.
    """

    dynamics: Dynamics
    table: LogTable
    columns: Columns
    source: Path | InMemory
    mapping: ColumnMapping
    settings: Settings
    problem: FittedProblem | None = None

    @property
    def robot(self) -> RobotDescription:
        return self.dynamics.robot

    @cached_property
    def rows(self) -> RawRows:
        """The recording's beginning, unchecked; all of a log of usual length.

        Numbers of drives that are too large to compute with are NaN.

        Raises:
            RecordingError: it cannot be read at all.
        """
        columns = self.columns
        beginnings = recut(read_batches(self.table, columns), _MOST)
        # Row by row in memory: the order decides how sums over rows are rounded.
        values = np.ascontiguousarray(next(beginnings, np.zeros((0, len(columns.all)))))
        time, values = values[:, 0], np.where(np.abs(values) < _OVERFLOWS, values, np.nan)
        counts = np.cumsum([len(columns.position), len(columns.velocity)])
        q, qd, _ = np.split(values[:, columns.motion_places], counts, axis=1)
        return RawRows(time, q, qd, values[:, columns.torque_places])

    @property
    def on_time(self) -> RawRows:
        """The rows with torques read as late as was given (`--lag`), to a whole row."""
        rows, lag = self.rows, self.settings.lag
        if isinstance(lag, str) or not rows.tau.shape[1]:
            return rows
        late = np.round(np.broadcast_to(lag, rows.tau.shape[1]) / rows.step).astype(int)
        places = np.arange(len(rows.time))[:, None] + late
        is_known = (places >= 0) & (places < len(rows.time))
        tau = np.take_along_axis(rows.tau, np.where(is_known, places, 0), axis=0)
        return replace(rows, tau=np.where(is_known, tau, np.nan))

    @cached_property
    def moved(self) -> Float[np.ndarray, " drives"]:
        """Range of each drive in these rows [rad or m]."""
        return np.ptp(self.rows.q, axis=0)

    @cached_property
    def stands(self) -> bool:
        """Whether no drive moves in these rows."""
        return len(self.rows.q) > 1 and float(self.moved.max()) < ENCODER_NOISE

    @cached_property
    def are_counts(self) -> bool:
        """Whether all positions of these rows are whole numbers in the file."""
        scales = np.array([channel.scale for channel in self.columns.position])
        numbers = self.rows.q / scales
        return bool(np.array_equal(numbers, np.round(numbers)) and np.any(self.moved))

    @property
    def written_mapping(self) -> dict[str, Any]:
        """Plain data of the mapping, including columns with default names."""
        written = self.mapping.model_dump(mode="json", exclude_unset=True)
        for quantity in QUANTITIES:
            if getattr(self.mapping, quantity) is None and getattr(self.columns, quantity):
                written[quantity] = [
                    {"column": entry.column, "unit": entry.unit} for entry in self.entries(quantity)
                ]
        return written

    def entries(self, quantity: Quantity) -> tuple[DriveColumn, ...]:
        """The mapping's entry of each drive, or that of its default name."""
        columns, drives = getattr(self.mapping, quantity), self.robot.drives
        if isinstance(columns, AllDrives):
            return columns.entries(len(drives), quantity)
        if columns is not None:
            return columns
        usual = [SI_UNITS[quantity][self.robot.is_linear(drive)] for drive in drives]
        names = (channel.column for channel in getattr(self.columns, quantity))
        pairs = zip(names, usual, strict=True)
        return tuple(DriveColumn(column=k, unit=self.table.units.get(k, unit)) for k, unit in pairs)

    def turned(self, quantity: Quantity, drive: int) -> dict[str, object]:
        return {"sign": -self.entries(quantity)[drive].sign}

    def in_unit(self, quantity: Quantity, drive: int, factor: float) -> dict[str, object]:
        """The unit whose numbers are `factor` times those of the present one; empty if unnamed."""
        now = self.entries(quantity)[drive].unit
        for (unit, by), name in _UNITS.items():
            if unit == now and abs(by / factor - 1) < 1e-6:
                return {"unit": name}
        return {}

    def of_motor(self, quantity: Quantity, drive: int, factor: float) -> dict[str, object]:
        """Gear or lead of a motor whose numbers must be multiplied by `factor`."""
        slower, robot = 1 / factor if quantity == "torque" else factor, self.robot
        if robot.is_linear(robot.drives[drive]):
            return {"unit": SI_UNITS[quantity][False], "lead": _rounded(2 * np.pi * slower)}
        return {"gear": _rounded(self.entries(quantity)[drive].gear / slower)}

    def taken_from(self, source: int, quantity: Quantity, drive: int) -> dict[str, object]:
        """Keys in which another drive's entry differs."""
        entry, other = (self.entries(quantity)[i].model_dump() for i in (drive, source))
        return {key: value for key, value in other.items() if value != entry[key]}

    def shifted(self, drive: int, shift: float) -> dict[str, object]:
        """The zero at which the joint value is larger by `shift` [rad or m]."""
        now, scale = self.entries("position")[drive].zero, self.columns.position[drive].scale
        return {"zero": float(f"{now - shift / scale:.6g}")}

    def proposal(self, values: Mapping[Quantity, Values]) -> tuple[Proposal, ...]:
        """New values of entries, by quantity, drive and key, as changes of the mapping."""
        changes: list[tuple[str, object]] = []
        for quantity, drives in values.items():
            columns, now = getattr(self.mapping, quantity), self.entries(quantity)
            if not isinstance(columns, AllDrives):
                for i, new in drives.items():
                    changes += [(f"{quantity}[{i}].{key}", value) for key, value in new.items()]
                continue
            for key in dict.fromkeys(key for new in drives.values() for key in new):
                old = [getattr(entry, key) for entry in now]
                new = [drives.get(i, {}).get(key, value) for i, value in enumerate(old)]
                same, plural = all(value == new[0] for value in new), key == "column"
                path = f"{quantity}.{key}" + "s" * plural
                changes.append((path, new[0] if same else new))
                if plural and columns.column is not None:
                    changes.append((f"{quantity}.column", None))
        return (Proposal("mapping", tuple(changes)),) if changes else ()

    @cached_property
    def setup(self) -> Setup | RecordingError:
        """The recording without the torques of declared loads."""
        settings, kinematics = self.settings, self.dynamics.kinematics
        try:
            opened = open_recordings(
                self.source, kinematics, self.mapping, settings.cutoff, keep_all=settings.keep_all
            )
            return declared_loads(Setup(self.robot, tuple(opened), settings), lambda _: None)
        except RecordingError as error:
            return error

    @cached_property
    def surveyed(self) -> PreparedRecording | None:
        """The surveyed recording that identification uses; None where an error prevents it."""
        return None if isinstance(self.setup, RecordingError) else self.setup.recordings[0]

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Doubts of the survey, or only of the file's layout where an error prevents a survey."""
        return self.table.warnings if self.surveyed is None else self.surveyed.log.warnings

    @cached_property
    def study(self) -> Study | None:
        """Study of this recording's residual; None without a survey."""
        if self.surveyed is None or self.problem is None:
            return self.surveyed and studied(self.dynamics, self.surveyed)
        corrected = tuple(term for term in self.problem.additions if term.is_corrected)
        return studied(self.dynamics, self.surveyed, self.problem.p, corrected)

    @cached_property
    def fitted(self) -> FittedProblem | RecordingError | IdentificationError:
        """The fit to this recording, or the error that prevents it."""
        setup = self.setup if self.problem is None else self.problem
        if not isinstance(setup, Setup):
            return setup
        try:
            return fit(self.dynamics, setup.recordings, self.settings, additions=setup.additions)
        except IdentificationError as error:
            return error


def evidence(
    robot: RobotDescription,
    source: RecordingLike,
    mapping: ColumnMapping | None = None,
    settings: Settings | None = None,
) -> Evidence:
    """Open a recording for checks, even with wrong numbers.

    Raises:
        RecordingError: it cannot be opened, or a column is missing.
    """
    dynamics, source = compiled(robot), as_source(source)
    table, columns, mapping = resolved_table(source, dynamics.kinematics, mapping)
    return Evidence(dynamics, table, columns, source, mapping, settings or Settings())


def forget(evidence: Evidence) -> None:
    """Drop cached rows and surveys: all recordings might not fit into memory."""
    _ = evidence.moved, evidence.stands
    for key in ("rows", "setup", "surveyed"):
        vars(evidence).pop(key, None)


def with_fit(
    evidence: Evidence, problem: FittedProblem, recording: PreparedRecording, study: Study | None
) -> Evidence:
    """The evidence with an existing survey, fit and study."""
    fitted = replace(evidence, dynamics=problem.dynamics, problem=problem)
    known: dict[str, object] = {
        k: v for k, v in vars(evidence).items() if k in ("rows", "moved", "stands")
    }
    if study is not None:
        known["study"] = study
    vars(fitted).update(known, surveyed=recording)  # where cached properties are kept
    return fitted


def _rounded(value: float) -> float:
    """Three digits, or a whole number within 2 %."""
    whole = round(value)
    if whole >= 2 and abs(value / whole - 1) < min(0.02, 0.25 / whole):
        return float(whole)
    return float(f"{value:.3g}")
