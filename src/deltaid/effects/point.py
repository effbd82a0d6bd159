"""The point about which effects are linearised, and the interface of effects in the contest.

`TracePoint` is a recording at given parameters, where slopes of its torques are taken. `RigidFit`
is such a point after least squares without effects. `UnknownEffect` is a cause with unknown
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

# Gauss–Newton steps of a fit with a factor for each drive, and the share of the largest singular
# value below which factors are not identifiable.
_SWEEPS, _SHOWN = 3, 0.05
# Speed below which motion is rounding [rad/s or m/s].
_RESTS = 1e-9
# Prior size of an effect that nothing is known of, as a share of a drive's torque [rms].
SIZE = 0.05

Deviations = Float[np.ndarray, " coefficients"]


@dataclass(frozen=True, eq=False)
class EffectCandidate:
    """Columns that one effect would add, to first order in its size."""

    kind: str
    subject: str  # the drive or joint; empty for all together
    columns: Columns  # over the rows of all drives
    words: str = ""  # for messages, such as what the torque varies with
    tries: float = 0.0  # decimal logarithm of the number of candidates it was chosen from
    detail: tuple[float, ...] = ()  # additional results, such as times
    # whether it is taken where another explains little more, for a check of its own judges it
    is_preferred: bool = False
    bends: bool = False  # whether it varies with the place of the platform


@dataclass(frozen=True, eq=False)
class TracePoint:
    """A recording and the robot's parameters; properties are at its filtered samples."""

    trace: Trace
    p: Parameters
    # fastest, highest: largest speed of each joint and torque of each drive over all recordings;
    # empty if these of this recording count
    fastest: dict[str, float] = field(default_factory=dict[str, float], kw_only=True)
    highest: tuple[float, ...] = field(default=(), kw_only=True)
    is_first: bool = field(default=True, kw_only=True)  # whether others are compared with it

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

    @property
    def fastest_platform(self) -> float:
        return float(np.linalg.norm(self.platform, axis=1).max(initial=_RESTS))

    @cached_property
    def model(self) -> OfDrives:
        return self.trace.model(self.p)

    @cached_property
    def regressor(self) -> ColumnsOfDrives:
        """The active columns of Y, filtered; several effects use them."""
        return self.trace.regressor()

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
        """Slopes of torques; friction keeps its direction."""
        w = self.motion
        return torque_slopes(self.dynamics, w.z, w.qd, w.qdd, self.p)

    def size(self, name: str) -> float:
        return float(self.p[self.dynamics.layout.names.index(name)])

    def coulomb(self, joints: Sequence[FrictionJoint]) -> Float[np.ndarray, " joints"]:
        """Coulomb friction of joints, at least as described."""
        described, names = self.dynamics.robot.friction, [joint.name for joint in joints]
        sizes = [max(abs(self.size(f"coulomb.{name}")), described[name].coulomb) for name in names]
        return np.array(sizes, dtype=float)

    def weighted(self, slopes: Sequence[np.ndarray]) -> ColumnsOfDrives:
        """Slopes as columns, times the weights of the samples."""
        weights = self.motion.weights.T
        columns = [slope * weights for slope in slopes]
        return np.stack(columns, axis=2) if columns else np.zeros((*weights.shape, 0))

    def of_joints(self, shapes: Sequence[tuple[FrictionJoint, Shape]]) -> ColumnsOfDrives:
        return joint_columns(self.trace, self.p, shapes)

    def added(self, addition: Addition) -> ColumnsOfDrives:
        """Columns of an addition that do not depend on the robot's."""

        def entries(w: SampleBlock) -> Float[np.ndarray, "entries samples"]:
            return addition.entries(w, np.zeros((0, len(w.time))), self.trace.recording)

        return self.trace.columns(entries, addition.pattern, len(addition.parameters))


@dataclass(frozen=True, eq=False)
class RigidFit(TracePoint):
    """A recording at the parameters of least squares without effects."""

    Y: ColumnsOfDrives  # the active columns of its regressor, filtered
    rows: DriveRows  # weights and stacks samples as rows
    span: Span  # of the columns Y as rows
    tau: Rows  # its torques as rows

    @cached_property
    def scaled_model(self) -> OfDrives:
        """Torques of parameters that are fitted together with a factor g_i for every drive.

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
    return [
        replace(point, fastest=fastest, highest=tuple(highest.tolist()), is_first=k == 0)
        for k, point in enumerate(points)
    ]


class UnknownEffect(ABC):
    """A cause with unknown coefficients that takes part in the contest.

    Attributes:
        name: unique.
        deviation: prior standard deviation of each coefficient; 0 where `deviations` differ.
        corrected_as, unit, text: kind, unit and words of its corrections, one a subject; the
            drive's own unit where none is given, no correction where there is no text.
        is_candidate: whether the contest corrects it where the rows need it. Otherwise it is a
            nuisance here, which keeps others from explaining its torque; another stage corrects it.
        is_positive: whether coefficients cannot be negative.
        is_of_parts: whether a tolerance of manufacture or mounting bounds it.
        is_own: whether each recording has its own coefficients.
        corrects: the readings of the drives or the robot, if these are corrected exactly; empty
            where the columns stay in the fit, or another stage estimates the coefficients.
        is_fitted: whether the final fit estimates it again, as parameters of the robot.
        is_late: whether it takes part only where the rows need it beside all others: it is costly.
        limit: largest norm of all coefficients; beyond it the effect is a doubt, not a correction:
            the description is wrong, or another cause mimics it.
    """

    name: str
    deviation: ClassVar[float] = 0.0
    corrected_as: ClassVar[Kind | None] = None
    unit: ClassVar[str] = ""
    text: ClassVar[str] = ""
    is_candidate: ClassVar[bool] = True
    is_positive: ClassVar[bool] = False
    is_of_parts: ClassVar[bool] = True
    is_own: ClassVar[bool] = False
    corrects: ClassVar[Literal["readings", "robot", ""]] = ""
    is_fitted: ClassVar[bool] = False
    is_late: ClassVar[bool] = False
    limit: ClassVar[float] = np.inf

    @abstractmethod
    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        """Slopes of the torques by its coefficients."""

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """Prior standard deviations of its coefficients; without a `deviation`, those that make the
        share `SIZE` of the drives' largest torques."""
        if self.deviation:
            return np.full(columns.shape[2], self.deviation)
        own = np.sqrt(np.mean((columns / point.largest[:, None, None]) ** 2, axis=(0, 1)))
        return SIZE / np.maximum(own, np.finfo(float).tiny ** 0.5)

    def stated(self, robot: RobotDescription) -> Deviations:
        """Standard deviations by tolerances of the description; zero where it states none."""
        return np.zeros(1)

    def is_possible(
        self, values: Deviations, covariance: Float[np.ndarray, "coefficients coefficients"]
    ) -> bool:
        """Whether physics allows such coefficients; if not, they mimic another cause."""
        return True

    def opened(self, robot: RobotDescription) -> RobotDescription:
        """The robot whose free parameters include the effect, if the final fit estimates it."""
        return robot

    def possible(self, values: Deviations) -> Deviations:
        """The nearest coefficients that physics allows."""
        return np.maximum(values, 0.0) if self.is_positive else values

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        """Corrections by coefficients and half widths of their 95 % intervals; of several of one
        subject the sum, as wide as the widest."""
        if not self.text or self.corrected_as is None:
            return ()
        subjects, scale = self.subjects(robot), 100.0 if self.unit == "%" else 1.0
        of_each, widths = (x.reshape(len(subjects), -1) for x in (values, half))
        sizes = (scale * np.stack([of_each.sum(axis=1), widths.max(axis=1)], axis=1)).tolist()
        return tuple(
            Correction(kind=self.corrected_as, subject=subject, value=value, low=value - wide,
                       high=value + wide, unit=self.unit or robot.units(subject).coordinate,
                       text=self.text)
            for subject, (value, wide) in zip(subjects, sizes, strict=True)
        )  # fmt: skip

    def subjects(self, robot: RobotDescription) -> Sequence[str]:
        """Owners of the coefficients, by default the drives."""
        return robot.drives

    def doubt(self, values: Deviations) -> str:
        """Words for coefficients beyond the limit: the finding, the likeliest cause, the fix."""
        return ""


class StagedEffect(UnknownEffect):
    """A nuisance in the contest that another stage corrects."""

    is_candidate = False


class Added(UnknownEffect):
    """An effect whose columns are an addition to the fit."""

    def __init__(self, name: str, addition: Addition) -> None:
        self.name, self.addition = name, addition

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.added(self.addition)
