"""Control laws of a drive as pure functions of measured state, desired motion and model.

With the tracking error e = q − q_d, and f the friction of the model:

    PD                −K e − D ė
    PD, feed-forward  M(q_d) q̈_d + C(q_d, q̇_d) q̇_d + g(q_d) + f(q̇_d) − K e − D ė
    computed torque   M(q) (q̈_d − 2ω ė − ω² e) + C(q, q̇) q̇ + g(q) + f(q̇_d)
    augmented PD      M(q) q̈_d + C(q, q̇) q̇_d + g(q) + f(q̇_d) − K e − D ė       (Paden, Panja 1988)
    Slotine–Li        M(q) q̈_r + C(q, q̇) q̇_r + g(q) + f(q̇_r) − K s            (Slotine, Li 1987)
                      with q̇_r = q̇_d − Λ e, s = q̇ − q̇_r

Friction is that of the desired (or reference) velocity: with the measured one it would switch with
noise at rest. As friction grows with speed, the difference dissipates energy. With the exact model,
by Ṁ = C + Cᵀ, only disturbances increase ½ eᵀKe + ½ ėᵀM ė for augmented PD and ½ sᵀM s for
Slotine–Li.

A model evaluates the left side of (1) with the arguments of a controller.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import get_args

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.control.options import ControllerName
from deltaid.control.plant import loaded, point_mass
from deltaid.dynamics.dynamics import Parameters, compiled
from deltaid.dynamics.joint_columns import with_load_friction
from deltaid.dynamics.task_dynamics import ROUNDS
from deltaid.kernel.batch import RowKernel
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.one_or_many import real_numbers
from deltaid.robot.description import RobotDescription


class ControlModel:
    """A robot's model for a controller, evaluated sample by sample or in batches.

    Args:
        robot: its description.
        p: its parameters; they need not be consistent.
    """

    def __init__(self, robot: RobotDescription, p: Parameters) -> None:
        self.robot, self.p = robot, real_numbers(p, "p").astype(float)
        self._kernel = _law(robot.model_dump_json())

    def holding(self, mass: float) -> "ControlModel":
        """The same model with a known point mass [kg] at the tool."""
        return ControlModel(self.robot, loaded(self.robot, self.p, point_mass(mass)))

    def torque(
        self, near: Samples, q: Samples, qd: Samples,
        along: Samples, acceleration: Samples, rubbing: Samples,
    ) -> Samples:  # fmt: skip
        """M(q) a + C(q, q̇) v + g(q) + f(w), with C from Christoffel symbols, ½Ṁ − C skew.

        Load-dependent friction is a share of the torque that gears carry, in the direction of w.

        Args:
            near: task coordinates near those of q, from which forward kinematics iterates.
            q: drive coordinates for M, C and g.
            qd: q̇ of C.
            along: v.
            acceleration: a.
            rubbing: w.
        """
        return self._kernel.rows(near, q, qd, along, acceleration, rubbing, uniform=self.p)[0]

    def mass_diagonal(self, q: Samples) -> Float[np.ndarray, " dof"]:
        """Mean diagonal of M over drive coordinates.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        M = compiled(self.robot).mass_matrix(q, self.p)
        return np.diagonal(M, axis1=1, axis2=2).mean(axis=0)

    def least_eigenvalue(self, q: Samples) -> float:
        """Smallest eigenvalue of M over drive coordinates, scaled to a unit mean diagonal.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        M = compiled(self.robot).mass_matrix(q, self.p)
        size = np.sqrt(np.abs(np.diagonal(M.mean(axis=0))))
        return float(np.linalg.eigvalsh(M / np.outer(size, size)).min())


@lru_cache(maxsize=8)
def _law(description: str) -> RowKernel:
    robot = RobotDescription.model_validate_json(description)
    dynamics, mechanism = compiled(robot), compiled(robot).kinematics.mechanism
    e = dynamics.equations
    near, q, along, acceleration, rubbing = (
        ca.SX.sym(name, dynamics.dof) for name in ("near", "q", "v", "a", "w")
    )
    torque = e.M @ acceleration + e.C @ along + e.g + ca.substitute(e.f, e.qd, rubbing)
    torque = with_load_friction(robot, torque, rubbing, acceleration, e.p)
    law = ca.Function("law", [e.z, e.qd, along, acceleration, rubbing, e.p], [torque])
    # Newton step of q(z) = q, by inverse kinematics.
    step = mechanism.z - mechanism.speeds.inverse_jacobian @ (mechanism.q - q)
    pose, move = near, ca.Function("move", [mechanism.z, q], [step])
    for _ in range(ROUNDS):
        pose = move(pose, q)
    torque = law(pose, e.qd, along, acceleration, rubbing, e.p)
    return RowKernel((near, q, e.qd, along, acceleration, rubbing), [torque], e.p)


CONTROLLERS: tuple[ControllerName, ...] = get_args(ControllerName)
# Controllers that need a positive definite mass matrix, not only torques of the desired motion.
NEED_MASS_MATRIX = CONTROLLERS[2:]

Gains = Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class Desired:
    """A desired motion, one time a row.

    Attributes:
        z: task coordinates.
        q, qd, qdd: drive coordinates, velocities, accelerations.
    """

    z: Samples
    q: Samples
    qd: Samples
    qdd: Samples


@dataclass(frozen=True)
class Controller:
    """A control law by name, with the gains of its formula.

    Attributes:
        stiffness: K of PD, one number for each drive [N m/rad or N/m].
        damping: D of PD, K of Slotine–Li [N m s/rad or N s/m].
        bandwidth: ω of computed torque, Λ of Slotine–Li [1/s].
    """

    name: ControllerName
    stiffness: Gains | float = 0.0
    damping: Gains | float = 0.0
    bandwidth: float = 0.0

    def torque(self, model: ControlModel, q: Samples, qd: Samples, desired: Desired) -> Samples:
        """Drive torques [N m or N] for measured coordinates and velocities, one sample a row."""
        d, w = desired, self.bandwidth
        error, error_rate = q - d.q, qd - d.qd
        feedback = -self.stiffness * error - self.damping * error_rate
        match self.name:
            case "pd":
                return feedback
            case "pd-feedforward":
                return model.torque(d.z, d.q, d.qd, d.qd, d.qdd, d.qd) + feedback
            case "computed-torque":
                acceleration = d.qdd - 2 * w * error_rate - w**2 * error
                return model.torque(d.z, q, qd, qd, acceleration, d.qd)
            case "augmented-pd":
                return model.torque(d.z, q, qd, d.qd, d.qdd, d.qd) + feedback
            case "slotine-li":
                velocity, acceleration = d.qd - w * error, d.qdd - w * error_rate
                along = model.torque(d.z, q, qd, velocity, acceleration, velocity)
                return along - self.damping * (qd - velocity)


def tuned(name: ControllerName, mass: Gains, bandwidth: float) -> Controller:
    """A controller whose error decays with two equal poles at −ω, ω = 2π `bandwidth`.

    With m the mean diagonal of M along the motion: K = m ω² and D = 2 m ω; computed torque has ω²
    and 2ω with M as a factor; Slotine–Li has Λ = ω and K = m ω. Near the desired motion all then
    have the same linear feedback and differ only in their knowledge of the robot.

    Args:
        mass: m [kg m² or kg].
        bandwidth: [Hz].
    """
    w = 2 * np.pi * bandwidth
    return Controller(name, mass * w**2, (1 if name == "slotine-li" else 2) * mass * w, w)
