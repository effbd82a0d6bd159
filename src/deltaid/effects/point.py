"""A recording at some parameters: what slopes of its torques are taken of."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import TorqueSlopes
from deltaid.dynamics.grown import grown_torques
from deltaid.effects.joint import Joint, Shape, joint_columns, joints_of
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import ColumnsOfDrives, OfDrives
from deltaid.estimation.traces import Trace
from deltaid.recording.windows import Samples


@dataclass(frozen=True, eq=False)
class Point:
    """Rows of a recording and the robot's parameters there."""

    trace: Trace
    p: Parameters
    fastest: dict[str, float] = field(default_factory=dict[str, float])  # of joints
    highest: tuple[float, ...] = ()  # recorded torque of each drive

    @property
    def dynamics(self) -> Dynamics:
        return self.trace.dynamics

    @property
    def dof(self) -> int:
        return self.dynamics.dof

    @cached_property
    def w(self) -> Samples:
        """The motion at the filtered samples."""
        return self.trace.motion()

    @cached_property
    def q(self) -> Float[np.ndarray, "samples dof"]:
        return self.dynamics.kinematics.inverse(self.w.z)

    @cached_property
    def platform(self) -> Float[np.ndarray, "samples 3"]:
        """Velocity of the platform."""
        J_x = self.dynamics.kinematics.platform_jacobian(self.w.z)
        return np.einsum("sij,sj->si", J_x, self.w.qd)

    @cached_property
    def model(self) -> OfDrives:
        return self.trace.model(self.p)

    @cached_property
    def largest(self) -> Float[np.ndarray, " dof"]:
        """Largest torque of each drive."""
        return np.maximum(np.abs(self.model).max(axis=1), np.finfo(float).tiny)

    @cached_property
    def recorded(self) -> OfDrives:
        """What amplifiers say of the model's torques, by the readings that are known so far."""
        readings = self.trace.recording.repairs.readings
        return self.model if readings is None else readings.recorded(self.model.T).T

    @cached_property
    def torque_max(self) -> Float[np.ndarray, " dof"]:
        """Largest recorded torque of each drive."""
        highest = self.highest or self.trace.recording.log.torque_max
        return np.maximum(np.array(highest), np.finfo(float).tiny)

    @cached_property
    def speeds(self) -> dict[str, float]:
        """Largest speed of each joint with friction."""
        entries = self.trace.entries(self.w)
        return {j.name: float(j.speed(entries).max()) for j in joints_of(self.dynamics)}

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """Joints with friction that move."""
        speeds = self.fastest or self.speeds
        return tuple(
            replace(joint, fastest=speeds[joint.name])
            for joint in joints_of(self.dynamics)
            if speeds[joint.name] > 0
        )

    @cached_property
    def slopes(self) -> TorqueSlopes:
        """Of torques without friction's steps, which have none."""
        smooth, layout, robot = self.p.copy(), self.dynamics.layout, self.dynamics.robot
        smooth[layout.friction] = 0.0
        smooth[layout.viscous] = self.p[layout.viscous]
        rates, gravity = np.hstack([self.w.qd, self.w.qdd]), np.array(robot.gravity)
        return TorqueSlopes(grown_torques(robot), self.w.z, rates, smooth, gravity)

    def coefficient(self, term: str, joint: Joint) -> float:
        """Size of a joint's friction."""
        return float(abs(self.p[self.dynamics.layout.names.index(f"{term}.{joint.name}")]))

    def weighted(self, slopes: Sequence[np.ndarray]) -> ColumnsOfDrives:
        """Columns of slopes at the filtered samples."""
        weights = self.w.weights.T
        columns = [slope * weights for slope in slopes]
        return np.stack(columns, axis=2) if columns else np.zeros((*weights.shape, 0))

    def of_joints(self, shapes: Sequence[tuple[Joint, Shape]]) -> ColumnsOfDrives:
        """A column for each shape of a joint."""
        if not shapes:
            return np.zeros((*self.model.shape, 0))
        return joint_columns(self.trace, self.p, shapes)

    def added(self, addition: Addition) -> ColumnsOfDrives:
        """Columns of an addition that does not need the robot's."""
        (rows, columns), recording = addition.pattern, self.trace.recording

        def entries(w: Samples) -> Float[np.ndarray, "entries samples"]:
            return addition.entries(w, np.zeros((0, len(w.time))), recording)

        filtered = self.trace.filtered(entries, rows)
        out = np.zeros((self.dof, filtered.shape[1], len(addition.parameters)))
        out[rows, :, columns] = filtered
        return out


def points_of(traces: Sequence[Trace], p: Parameters) -> list[Point]:
    """Recordings at the same parameters, with the largest speeds and torques of all."""
    points = [Point(trace, p) for trace in traces]
    names = points[0].speeds
    fastest = {name: max(point.speeds[name] for point in points) for name in names}
    highest = np.max([trace.recording.log.torque_max for trace in traces], axis=0)
    return [replace(point, fastest=fastest, highest=tuple(highest.tolist())) for point in points]
