"""How much of its limits a robot uses along a motion in task coordinates."""

from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.equations import build_task_motion
from deltaid.dynamics.limits import kinematic_limits, torque_limits
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.kinematics import Samples

Shares = Float[np.ndarray, "samples limits"]


class LimitsAlong:
    """Use of a robot's limits, 1 at the limit, sample by sample.

    Attributes:
        names: of the limits that need no torque, in the order of `kinematic`.
        efforts: names of the drives' torque or force limits, in the order of `effort`.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        robot, mechanism = dynamics.robot, dynamics.kinematics.mechanism
        self._motion = build_task_motion(robot, mechanism)
        self._limits = kinematic_limits(robot, mechanism, self._motion)
        self.names: tuple[str, ...] = tuple(limit.name for limit in self._limits)
        self._largest = torque_limits(robot)
        drives = [robot.drives[i] for i in self._largest]
        self.efforts: tuple[str, ...] = tuple(f"{d} {robot.units(d).effort}" for d in drives)

    def kinematic(self, z: Samples, zd: Samples, zdd: Samples) -> Shares:
        """Of speeds, accelerations, ranges, workspace, distance from singularities."""
        u = self._kernel(np.hstack([z, zd, zdd]).T).T
        two_sided = np.array([limit.two_sided for limit in self._limits])
        return np.where(two_sided, np.abs(u), u)

    def effort(self, z: Samples, zd: Samples, zdd: Samples, p: Parameters) -> Shares:
        """Of the drives' torques, with parameters p."""
        _, qd, qdd = self.dynamics.kinematics.drive_motion(z, zd, zdd)
        tau = self.dynamics.torque(z, qd, qdd, p)
        return np.abs(tau[:, list(self._largest)]) / np.array(list(self._largest.values()))

    @cached_property
    def _kernel(self) -> BatchKernel:
        m = self._motion
        s = ca.vertcat(m.z, m.zd, m.zdd)
        return BatchKernel(s, ca.vertcat(*[limit.u for limit in self._limits]))
