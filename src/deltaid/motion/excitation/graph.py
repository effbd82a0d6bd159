"""What an excitation needs of a robot at one instant, as kernels with exact derivatives.

For the motion s = (z, ż, z̈) of one instant: the nonzero entries of the base regressor, drive
speeds, and every kinematic limit as a number u that must stay within [−1, 1] (or below 1).
Gradients come from the same graph: a reverse sweep for the regressor (which serves the torques as
well), a sparse Jacobian for the limits.
"""

from functools import cached_property

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

    Args:
        dynamics: the robot.
        columns: the parameters whose regressor columns are to be excited.
    """

    def __init__(self, dynamics: Dynamics, columns: Int[np.ndarray, " base"]) -> None:
        self.dynamics, mechanism = dynamics, dynamics.kinematics.mechanism
        m = self._smooth = build_task_motion(dynamics.robot, mechanism, _smooth_sign)
        self._exact = build_task_motion(dynamics.robot, mechanism)
        self._at = columns.tolist()
        self.limits: tuple[Limit, ...] = kinematic_limits(dynamics.robot, mechanism, m)
        self._u = ca.vertcat(*[limit.u for limit in self.limits])
        self._s = ca.vertcat(m.z, m.zd, m.zdd)
        self._slopes = ca.jacobian(self._u, self._s)
        self._outputs = ca.vertcat(self._entries(m), m.qd)

    @cached_property
    def regressor_pattern(self) -> Pattern:
        """Drive and base column of each regressor entry, drive by drive."""
        columns, rows = self._smooth.Y[:, self._at].T.sparsity().get_triplet()
        return np.array(rows), np.array(columns)

    @cached_property
    def limit_pattern(self) -> Pattern:
        """Limit and entry of s of each nonzero of ∂u/∂s."""
        rows, columns = self._slopes.sparsity().get_triplet()
        return np.array(rows), np.array(columns)

    @cached_property
    def regressor(self) -> BatchKernel:
        """s → regressor entries with smooth signs, then the drive speeds."""
        return BatchKernel(self._s, self._outputs)

    @cached_property
    def exact_regressor(self) -> BatchKernel:
        """s → regressor entries as they are."""
        m = self._exact
        return BatchKernel(ca.vertcat(m.z, m.zd, m.zdd), self._entries(m))

    @cached_property
    def pullback(self) -> BatchKernel:
        """(s, λ) → Σ λ_i ∂o_i/∂s for the outputs o of `regressor`."""
        weights = ca.SX.sym("w", self._outputs.numel())
        gradient = ca.gradient(ca.dot(weights, self._outputs), self._s)
        return BatchKernel(ca.vertcat(self._s, weights), gradient)

    @cached_property
    def limit_values(self) -> BatchKernel:
        """Kernel of s → u, all limits."""
        return BatchKernel(self._s, self._u)

    @cached_property
    def limit_slopes(self) -> BatchKernel:
        """s → nonzeros of ∂u/∂s."""
        return BatchKernel(self._s, self._slopes.nz[:])

    def _entries(self, motion: TaskMotion) -> ca.SX:
        return motion.Y[:, self._at].T.nz[:]

    def dense(
        self, entries: Float[np.ndarray, "entries samples"]
    ) -> Float[np.ndarray, "samples dof base"]:
        """Regressor entries as matrices."""
        Y = np.zeros((entries.shape[1], self.dynamics.dof, len(self._at)))
        Y[:, *self.regressor_pattern] = entries.T
        return Y


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
