"""A recording at some parameters: what slopes of its torques are taken of, what parameters leave of
them, and columns that effects would add."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

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
from deltaid.recording.windows import SampleBlock

# Sweeps of a fit with a factor for each drive; directions below this share are excluded.
_SWEEPS, _SHOWN = 3, 0.05


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
        return np.maximum(np.abs(self.model).max(axis=1), np.finfo(float).tiny)

    @cached_property
    def speeds(self) -> dict[str, float]:
        """Largest speed of each joint with friction."""
        entries = self.trace.entries(self.motion)
        return {j.name: float(j.speed(entries).max()) for j in joints_of(self.dynamics)}

    @cached_property
    def joints(self) -> tuple[FrictionJoint, ...]:
        speeds = self.fastest or self.speeds
        joints = [replace(joint, fastest=speeds[joint.name]) for joint in joints_of(self.dynamics)]
        return tuple(joint for joint in joints if joint.fastest > 0)

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
