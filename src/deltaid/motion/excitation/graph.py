"""What an excitation needs of a robot at one instant, as kernels with exact derivatives.

For the motion s = (z, ż, z̈) of one instant: the nonzero entries of the base regressor, drive
speeds, and every kinematic limit as a number u that must stay within [−1, 1] (or below 1).
Gradients come from the same graph: a reverse sweep for the regressor (which serves the torques as
well), a sparse Jacobian for the limits.
"""

import casadi as ca
import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.equations import TaskMotion, build_task_motion
from deltaid.dynamics.limits import Limit, kinematic_limits, torque_limits
from deltaid.errors import DeltaidError
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.friction_terms import at_rest

# Speed over which the optimiser sees Coulomb friction change its sign [rad/s, m/s]. Its columns are
# judged with the true sign afterwards.
_SIGN_WIDTH = 0.05


# Row and column of each entry of a sparse matrix.
Pattern = tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]


class ExcitationGraph:
    """Kernels of one robot for one choice of base columns.

    Attributes:
        limits: all kinematic limits.
        regressor: s → regressor entries with smooth signs, then the drive speeds.
        exact_regressor: s → regressor entries as they are.
        pullback: (s, λ) → Σ λ_i ∂o_i/∂s for the outputs o of `regressor`.
        limit_values, limit_slopes: s → u, all limits, and s → nonzeros of ∂u/∂s.
        regressor_pattern: drive and base column of each regressor entry, drive by drive.
        limit_pattern: limit and entry of s of each nonzero of ∂u/∂s.

    Args:
        dynamics: the robot.
        columns: the parameters whose regressor columns are to be excited.
    """

    def __init__(self, dynamics: Dynamics, columns: Int[np.ndarray, " base"]) -> None:
        self.dynamics, robot, mechanism = dynamics, dynamics.robot, dynamics.kinematics.mechanism
        self._at = columns.tolist()
        smooth, exact = (
            build_task_motion(robot, mechanism, *sign) for sign in ([_smooth_sign], [])
        )
        s, exact_s = (ca.vertcat(m.z, m.zd, m.zdd) for m in (smooth, exact))
        self.limits: tuple[Limit, ...] = kinematic_limits(robot, mechanism, smooth)
        u, outputs = (
            ca.vertcat(*(x.u for x in self.limits)),
            ca.vertcat(self._entries(smooth), smooth.qd),
        )
        weights, slopes = ca.SX.sym("w", outputs.numel()), ca.jacobian(u, s)
        gradient = ca.gradient(ca.dot(weights, outputs), s)
        self.regressor, self.limit_values = BatchKernel(s, outputs), BatchKernel(s, u)
        self.exact_regressor = BatchKernel(exact_s, self._entries(exact))
        self.pullback = BatchKernel(ca.vertcat(s, weights), gradient)
        self.limit_slopes = BatchKernel(s, slopes.nz[:])
        entries = smooth.Y[:, self._at].T
        self.regressor_pattern, self.limit_pattern = _pattern(entries)[::-1], _pattern(slopes)

    def _entries(self, motion: TaskMotion) -> ca.SX:
        return motion.Y[:, self._at].T.nz[:]

    def dense(
        self, entries: Float[np.ndarray, "entries samples"]
    ) -> Float[np.ndarray, "samples dof base"]:
        """Regressor entries as matrices."""
        Y = np.zeros((entries.shape[1], self.dynamics.dof, len(self._at)))
        Y[:, *self.regressor_pattern] = entries.T
        return Y


def _pattern(matrix: ca.SX) -> Pattern:
    rows, columns = matrix.sparsity().get_triplet()
    return np.array(rows), np.array(columns)


def _smooth_sign(velocity: ca.SX) -> ca.SX:
    return ca.tanh(velocity / _SIGN_WIDTH)


# Length [m] by which a turning passive joint's friction becomes a force at the platform.
_LEVER = 0.1


def torques_without_friction(dynamics: Dynamics) -> dict[int, float]:
    """Torque limits less what Coulomb friction takes at the prior.

    The optimiser sees friction change its sign smoothly, which is less than the true friction at
    low speed; this much room covers the difference.

    Raises:
        DeltaidError: friction alone takes the whole torque.
    """
    robot, left = dynamics.robot, dict[int, float]()
    arms = [limb.upper_arm or 1.0 for limb in robot.limb_geometry]
    # A passive joint's friction reaches a drive through a lever of about the arm's length.
    passive = sum(
        at_rest(law) / (1.0 if robot.is_linear(joint) else _LEVER)
        for joint, law in robot.friction.items()
        if joint not in robot.drives
    )
    for i, largest in torque_limits(robot).items():
        drive, law = robot.drives[i], robot.friction.get(robot.drives[i])
        own = at_rest(law) + (law.load or 0.0) * largest if law else 0.0
        left[i] = largest - own - (passive * arms[i] if i < len(arms) else 0.0)
        if left[i] <= 0:
            unit, key = robot.units(drive).force, robot.units(drive).effort
            raise DeltaidError(
                f"a {key} limit of {largest:g} {unit} is no more than the joint's Coulomb friction",
                where=f"{robot.name}, drive_limits.{drive}.{key}",
                cure="raise the limit, or lower the friction's prior",
            )
    return left
