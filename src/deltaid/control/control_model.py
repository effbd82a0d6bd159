"""What a controller asks its model for: the left side of (1) with arguments of the controller's."""

from functools import lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.control.plant import loaded, point_mass
from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.dynamics.joint_columns import with_load_friction
from deltaid.kernel.batch import BatchKernel
from deltaid.kernel.real import real_numbers
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.mechanism import Mechanism
from deltaid.robot.description import RobotDescription

# Newton steps from the desired to the measured pose. Each squares the distance: a centimetre of
# tracking error is below rounding after three.
_STEPS = 3


class ControlModel:
    """A robot's model as a controller evaluates it, sample by sample or in batches.

    Args:
        robot: its description.
        p: its parameters; they need not be consistent.
    """

    def __init__(self, robot: RobotDescription, p: Parameters) -> None:
        self.robot, self.p = robot, real_numbers(p, "p").astype(float)
        self._kernel = _law(robot.model_dump_json())

    def holding(self, mass: float) -> "ControlModel":
        """The same that knows of a load, a mass [kg] at the tool."""
        return ControlModel(self.robot, loaded(self.robot, self.p, point_mass(mass)))

    @property
    def dynamics(self) -> Dynamics:
        """Dynamics of the robot, compiled where needed."""
        return compiled(self.robot)

    def torque(
        self,
        near: Samples,
        q: Samples,
        qd: Samples,
        along: Samples,
        acceleration: Samples,
        rubbing: Samples,
    ) -> Samples:
        """M(q) a + C(q, q̇) v + g(q) + f(w), with C from Christoffel symbols, ½Ṁ − C skew.

        Friction that depends on load is a share of what gears carry, in the direction of w.

        Args:
            near: task coordinates near those of q, from which forward kinematics iterates.
            q: where M, C and g are taken; with
            qd: q̇ of C.
            along: v.
            acceleration: a.
            rubbing: w.
        """
        x = np.hstack([near, q, qd, along, acceleration, rubbing]).T
        return self._kernel(x, uniform=self.p).T

    def mass_diagonal(self, q: Samples) -> Float[np.ndarray, " dof"]:
        """Mean of M's diagonal at some drive coordinates.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        return np.diagonal(self.dynamics.mass_matrix(q, self.p), axis1=1, axis2=2).mean(axis=0)

    def least_eigenvalue(self, q: Samples) -> float:
        """Smallest eigenvalue of M, scaled to a unit diagonal of its mean, at drive coordinates.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        M = self.dynamics.mass_matrix(q, self.p)
        size = np.sqrt(np.abs(np.diagonal(M.mean(axis=0))))
        return float(np.linalg.eigvalsh(M / np.outer(size, size)).min())


@lru_cache(maxsize=8)
def _law(description: str) -> BatchKernel:
    robot = RobotDescription.model_validate_json(description)
    dynamics = compiled(robot)
    e, dof = dynamics.equations, dynamics.dof
    near, q, along, acceleration, rubbing = (
        ca.SX.sym(name, dof) for name in ("near", "q", "v", "a", "w")
    )
    torque = e.M @ acceleration + e.C @ along + e.g + ca.substitute(e.f, e.qd, rubbing)
    torque = with_load_friction(robot, torque, rubbing, acceleration, e.p)
    law = ca.Function("law", [e.z, e.qd, along, acceleration, rubbing, e.p], [torque])
    pose = _located(dynamics.kinematics.mechanism, near, q)
    x = ca.vertcat(near, q, e.qd, along, acceleration, rubbing)
    return BatchKernel(x, law(pose, e.qd, along, acceleration, rubbing, e.p), uniform=e.p)


def _located(mechanism: Mechanism, near: ca.SX, q: ca.SX) -> ca.SX:
    """z with q(z) = q by Newton's method on inverse kinematics."""
    step = mechanism.z - mechanism.speeds.inverse_jacobian @ (mechanism.q - q)
    move = ca.Function("move", [mechanism.z, q], [step])
    for _ in range(_STEPS):
        near = move(near, q)
    return near
