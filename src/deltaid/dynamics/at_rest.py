"""Statics of a robot: drive coordinates, holding torques, condition and use of every limit."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.limits import (
    Limit,
    effort_names,
    kinematic_limits,
    torque_limits,
    workspace_limits,
)
from deltaid.errors import KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.regularity import SINGULAR_CONDITION
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Poses:
    """A robot at rest at many poses, one a row.

    Attributes:
        z: task coordinates [m; rad].
        q: drive coordinates [rad or m].
        torque: what the drives hold it with: gravity, springs, offsets of friction [N m or N].
        condition: ‖J‖_F ‖J⁻¹‖_F / δ.
        shares: use |u| of each limit, 1 at the limit, in the order of `AtRest.limits`.
        stands: whether the pose exists: every limb reaches it, and it lies on the home pose's side
            of singularities. All numbers but z are NaN where it does not.
    """

    z: Samples
    q: Samples
    torque: Samples
    condition: Float[np.ndarray, " samples"]
    shares: Float[np.ndarray, "samples limits"]
    stands: Bool[np.ndarray, " samples"]

    def only(self, chosen: Bool[np.ndarray, " samples"]) -> "Poses":
        """A subset of the poses."""
        arrays = {name: getattr(self, name)[chosen] for name in self.__dataclass_fields__}
        return replace(self, **arrays)


class AtRest:
    """A robot with parameters p, evaluated at rest.

    Attributes:
        limits: names of all limits that a pose alone can break: those of the workspace first, then
            the machine's own.
        of_workspace: how many are the workspace's.

    Raises:
        KinematicsError: the robot cannot stand in the middle of its own workspace.
    """

    def __init__(self, dynamics: Dynamics, p: Parameters) -> None:
        self.dynamics, self.p = dynamics, p
        self.robot: RobotDescription = dynamics.robot
        mechanism = dynamics.kinematics.mechanism
        posed = kinematic_limits(self.robot, mechanism)
        names = (*(limit.name for limit in posed), *effort_names(self.robot))
        self.limits: tuple[str, ...] = names
        self.of_workspace = len(workspace_limits(self.robot, mechanism.z))
        self._kernel = self._build(mechanism, posed)
        self.home = dynamics.kinematics.home
        dynamics.kinematics.inverse(self.home[None])  # raises with the limb that does not reach
        dynamics.kinematics.require_regular(self.home[None])
        self._side = np.sign(dynamics.kinematics.regularity(self.home[None]).determinant[0])

    def _build(self, mechanism: Mechanism, posed: tuple[Limit, ...]) -> BatchKernel:
        """q, torque, condition, shares, reach and det J of z; p is uniform."""
        equations = self.dynamics.equations
        still, moving = ca.SX.zeros(2 * mechanism.dof), ca.vertcat(equations.qd, equations.qdd)
        torque = ca.substitute(ca.densify(equations.torque), moving, still)
        shares = [limit.u for limit in posed]
        shares += [torque[i] / largest for i, largest in torque_limits(self.robot).items()]
        determinant = ca.det(mechanism.scaled_jacobian)
        parts = (mechanism.q, torque, mechanism.condition, *shares, determinant, mechanism.reach)
        return BatchKernel(equations.z, ca.vertcat(*parts), uniform=equations.p)

    def __call__(self, z: Samples) -> Poses:
        """The robot at rest at some poses."""
        z = np.asarray(z, dtype=float)
        δ, limits = self.dynamics.dof, len(self.limits)
        out = self._kernel(z.T, uniform=self.p).T
        q, torque, condition, shares, determinant, reach = np.split(
            out, np.cumsum([δ, δ, 1, limits, 1]), axis=1
        )
        stands = np.all(reach > 0, axis=1) & (np.sign(determinant[:, 0]) == self._side)
        stands &= (condition[:, 0] < SINGULAR_CONDITION) & np.all(np.isfinite(q), axis=1)
        gone = ~stands[:, None]
        return Poses(
            z=z,
            q=np.where(gone, np.nan, q),
            torque=np.where(gone, np.nan, torque),
            condition=np.where(stands, condition[:, 0], np.nan),
            shares=np.where(gone, np.nan, np.abs(shares)),
            stands=stands,
        )

    def why_not(self, z: Float[np.ndarray, " dof"]) -> str:
        """Why a pose does not exist."""
        kinematics = self.dynamics.kinematics
        try:
            kinematics.inverse(z[None])
            kinematics.require_regular(z[None])
        except KinematicsError as error:
            return error.what
        return "every limb reaches the pose, but it lies beyond a singularity from the home pose"
