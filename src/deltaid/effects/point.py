"""Where effects are linearised, and what an effect of the contest of causes has to provide.

`TracePoint` is a recording at given parameters, where slopes of its torques are taken. `RigidFit`
is such a point after least squares without effects. `UnknownEffect` is one cause with unknown
coefficients: columns, prior, bounds, exact application, words.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import TorqueSlopes, torque_slopes
from deltaid.effects.joint import FrictionJoint, Shape, joint_columns, joints_of
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import ColumnsOfDrives, DriveRows, OfDrives
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Columns, Rows, Span
from deltaid.estimation.traces import Trace
from deltaid.model.corrections import Correction, Kind
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription

# Sweeps of a fit with a factor for each drive; directions below this share are excluded.
_SWEEPS, _SHOWN = 3, 0.05
# Speeds of a drive that rests are rounding below this [rad/s or m/s].
_RESTS = 1e-9
# What nobody described makes some such share of a drive's torque, before any recording [rms].
SIZE = 0.05

Deviations = Float[np.ndarray, " coefficients"]


@dataclass(frozen=True, eq=False)
class EffectCandidate:
    """Columns that one effect would add, to first order in its size."""

    kind: str
    subject: str  # the drive or joint; empty for all together
    columns: Columns  # as rows of all drives
    words: str = ""  # what the torque follows, for messages
    tries: float = 0.0  # how many of its like it was chosen from, as a decimal logarithm
    detail: tuple[float, ...] = ()  # further results, such as times
    # whether it is taken where another explains little more: other checks judge it better
    is_preferred: bool = False
    bends: bool = False  # whether it bends with the place of the platform


@dataclass(frozen=True, eq=False)
class TracePoint:
    """A recording and the robot's parameters; properties are at its filtered samples."""

    trace: Trace
    p: Parameters
    # fastest, highest: largest speed of each joint and torque of each drive, where those of other
    # recordings count too
    fastest: dict[str, float] = field(default_factory=dict[str, float], kw_only=True)
    highest: tuple[float, ...] = field(default=(), kw_only=True)

    @property
    def dynamics(self) -> Dynamics:
        return self.trace.dynamics

    @property
    def dof(self) -> int:
        return self.dynamics.dof

    @property
    def drives(self) -> tuple[str, ...]:
        return self.dynamics.robot.drives

    @cached_property
    def motion(self) -> SampleBlock:
        return self.trace.motion()

    @cached_property
    def q(self) -> Float[np.ndarray, "samples dof"]:
        return self.dynamics.kinematics.inverse(self.motion.z)

    @cached_property
    def platform(self) -> Float[np.ndarray, "samples 3"]:
        J_x = self.dynamics.kinematics.platform_jacobian(self.motion.z)
        return np.einsum("sij,sj->si", J_x, self.motion.qd)

    @cached_property
    def model(self) -> OfDrives:
        return self.trace.model(self.p)

    @cached_property
    def largest(self) -> Float[np.ndarray, " dof"]:
        largest = np.abs(self.model).max(axis=1)
        return np.where(largest > 0, largest, 1.0)  # any, of a drive that rests all the time

    @cached_property
    def speeds(self) -> dict[str, float]:
        """Largest speed of each joint with friction."""
        entries = self.trace.entries(self.motion)
        return {j.name: float(j.speed(entries).max()) for j in joints_of(self.dynamics)}

    @cached_property
    def joints(self) -> tuple[FrictionJoint, ...]:
        speeds = self.fastest or self.speeds
        joints = [replace(joint, fastest=speeds[joint.name]) for joint in joints_of(self.dynamics)]
        return tuple(joint for joint in joints if joint.fastest > _RESTS)

    @property
    def driven(self) -> tuple[FrictionJoint, ...]:
        return tuple(joint for joint in self.joints if joint.drive is not None)

    @cached_property
    def slopes(self) -> TorqueSlopes:
        """Of torques; friction keeps its direction."""
        w = self.motion
        return torque_slopes(self.dynamics, w.z, w.qd, w.qdd, self.p)

    def size(self, name: str) -> float:
        return float(self.p[self.dynamics.layout.names.index(name)])

    def weighted(self, slopes: Sequence[np.ndarray]) -> ColumnsOfDrives:
        """Columns of slopes at the filtered samples."""
        weights = self.motion.weights.T
        columns = [slope * weights for slope in slopes]
        return np.stack(columns, axis=2) if columns else np.zeros((*weights.shape, 0))

    def of_joints(self, shapes: Sequence[tuple[FrictionJoint, Shape]]) -> ColumnsOfDrives:
        return joint_columns(self.trace, self.p, shapes)

    def added(self, addition: Addition) -> ColumnsOfDrives:
        """Columns of an addition that does not need the robot's."""

        def entries(w: SampleBlock) -> Float[np.ndarray, "entries samples"]:
            return addition.entries(w, np.zeros((0, len(w.time))), self.trace.recording)

        return self.trace.columns(entries, addition.pattern, len(addition.parameters))


@dataclass(frozen=True, eq=False)
class RigidFit(TracePoint):
    """A recording before its effects are known, at the parameters of least squares."""

    Y: ColumnsOfDrives  # the active columns of its regressor, filtered
    # rows, span: its samples as rows, and what these columns explain of them
    rows: DriveRows
    span: Span
    tau: Rows  # its torques as rows

    @cached_property
    def scaled_model(self) -> OfDrives:
        """Torques of parameters that are fitted together with a factor for every drive.

        τ_i = (1 + g_i) Y_i p, by Gauss–Newton. Hardly identifiable factors, such as one common to
        all, stay 1.
        """
        model = self.model
        for _ in range(_SWEEPS):
            columns = self.rows.per_drive(model)
            residual = self.span.without(self.tau)
            gain = np.linalg.lstsq(self.span.without(columns), residual, rcond=_SHOWN)[0]
            model = self.Y @ self.span.coefficients(self.tau - columns @ gain)
        return model

    def shows(self, name: str) -> bool:
        return self.dynamics.layout.names.index(name) in active_columns(self.dynamics)

    def column(self, name: str) -> OfDrives:
        k = self.dynamics.layout.names.index(name)
        return self.Y[:, :, np.searchsorted(active_columns(self.dynamics), k)]


def points_of(traces: Sequence[Trace], p: Parameters) -> list[TracePoint]:
    """Recordings at the same parameters, with the largest speeds and torques of all."""
    points = [TracePoint(trace, p) for trace in traces]
    fastest = {name: max(point.speeds[name] for point in points) for name in points[0].speeds}
    highest = np.max([trace.recording.log.torque_max for trace in traces], axis=0)
    return [replace(point, fastest=fastest, highest=tuple(highest.tolist())) for point in points]


class UnknownEffect(ABC):
    """A cause with unknown coefficients that takes part in the contest.

    Attributes:
        name: unique.
        deviation: prior standard deviation of each coefficient; 0 where `deviations` differ.
        corrected_as, unit, text: kind, unit and words of its corrections, one a subject; the
            drive's own unit where none is given, no correction where there is no text.
        is_candidate: it is corrected where the rows need it. Otherwise it is a nuisance here, which
            keeps others from explaining its torque, and a stage of its own corrects it.
        is_positive: physics allows no coefficient below zero.
        is_of_parts: a tolerance of manufacture or mounting bounds it to a few deviations.
        is_own: each recording has coefficients of its own.
        corrects: what its coefficients are applied to exactly: readings of the drives or the robot;
            empty where they stay columns of the fit, or a stage of its own estimates them.
        is_fitted: the final fit estimates it again, as parameters of the robot.
        limit: norm of all coefficients above which it is a doubt instead of a correction: then the
            description is wrong, or another cause mimics it.
    """

    name: str
    deviation: ClassVar[float] = 0.0
    corrected_as: ClassVar[Kind]
    unit: ClassVar[str] = ""
    text: ClassVar[str] = ""
    is_candidate: ClassVar[bool] = True
    is_positive: ClassVar[bool] = False
    is_of_parts: ClassVar[bool] = True
    is_own: ClassVar[bool] = False
    corrects: ClassVar[Literal["readings", "robot", ""]] = ""
    is_fitted: ClassVar[bool] = False
    limit: ClassVar[float] = np.inf

    @abstractmethod
    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        """Slopes of the torques by its coefficients."""

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """Prior standard deviations of its coefficients; where nothing is known, those whose torque
        is `SIZE` of the drives' largest."""
        if self.deviation:
            return np.full(columns.shape[2], self.deviation)
        own = np.sqrt(np.mean((columns / point.largest[:, None, None]) ** 2, axis=(0, 1)))
        return SIZE / np.maximum(own, np.finfo(float).tiny ** 0.5)

    def stated(self, robot: RobotDescription) -> Deviations:
        """Standard deviations by the tolerances that the description states; one zero without."""
        return np.zeros(1)

    def is_possible(
        self, values: Deviations, covariance: Float[np.ndarray, "coefficients coefficients"]
    ) -> bool:
        """Whether physics allows such coefficients; if not, they imitate another cause."""
        return True

    def possible(self, values: Deviations) -> Deviations:
        return np.maximum(values, 0.0) if self.is_positive else values

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        """What was corrected, for coefficients and half widths of their 95 % intervals."""
        if not self.text:
            return ()
        scale = 100.0 if self.unit == "%" else 1.0
        sizes = (scale * np.stack([values, half], axis=1)).tolist()
        return tuple(
            Correction(kind=self.corrected_as, subject=subject, value=value, low=value - wide,
                       high=value + wide, unit=self.unit or robot.units(subject).coordinate,
                       text=self.text)
            for subject, (value, wide) in zip(self.subjects(robot), sizes, strict=True)
        )  # fmt: skip

    def subjects(self, robot: RobotDescription) -> Sequence[str]:
        """Whose coefficients these are: the drives', if not said otherwise."""
        return robot.drives

    def doubt(self, values: Deviations) -> str:
        """Words for coefficients beyond the limit: the finding, the likeliest cause, the fix."""
        return ""


class StagedEffect(UnknownEffect):
    """A nuisance of the contest that a stage of its own corrects."""

    is_candidate = False


class Added(UnknownEffect):
    """An effect whose columns are an addition to the fit."""

    def __init__(self, name: str, addition: Addition) -> None:
        self.name, self.addition = name, addition

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.added(self.addition)
