"""All joints of a robot in numbers, as a publisher of joint states wants them; and how fast those
without a drive move along a motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.one_or_many import one_or_many
from deltaid.mechanism.tree_joints import JointStates, TreeJoints, tree_joints
from deltaid.robot.description import RobotDescription

Samples = Float[np.ndarray, "samples dof"]


class WithJointStates:
    """Kinematics that knows all joints of the tree."""

    robot: RobotDescription
    mechanism: Mechanism

    forward: Callable[[Samples], Samples]

    @one_or_many("q", "qd")
    def joint_states(self, q: Samples, qd: Samples | None = None) -> JointStates:
        """All joints of the robot's tree, drives first.

        Names, signs and zeros are those of the MJCF and URDF exports (`mechanism.tree_joints`).

        Args:
            q: drive coordinates; rows are consecutive samples, as in `forward`.
            qd: drive velocities; without them there are no velocities.

        Raises:
            KinematicsError: q closes no loop or is singular.
            DeltaidError: the mechanism is the user's own, so its joints are not known.
        """
        return self._all_joints.states(self.forward(q), qd)

    @one_or_many("z", "qd")
    def passive_joints(self, z: Samples, qd: Samples | None = None) -> JointStates:
        """The same for the joints without a drive, from task coordinates z; NaN out of reach.

        Raises:
            DeltaidError: the mechanism is the user's own, so its joints are not known.
        """
        return self._passive_joints.states(z, qd)

    @cached_property
    def _all_joints(self) -> TreeJoints:
        return tree_joints(self.robot, self.mechanism)

    @cached_property
    def _passive_joints(self) -> TreeJoints:
        return tree_joints(self.robot, self.mechanism, passive=True)


@dataclass(frozen=True, eq=False)
class JointRates:
    """Joints for many samples.

    Attributes:
        speed, acceleration: ϑ̇, ϑ̈ [rad/s or m/s, and per s].
        slope: ∂ϑ/∂q.
    """

    speed: Float[np.ndarray, "samples joints"]
    acceleration: Float[np.ndarray, "samples joints"]
    slope: Float[np.ndarray, "samples joints dof"]


class PassiveJoints:
    """Some joints ϑ(z) of a mechanism: ϑ̇ = ∂ϑ/∂z T q̇ and its derivative, T = ∂z/∂q.

    Attributes:
        names: of the joints.
        moved_by: for each joint whether a drive moves it at all, (joints, dof).
    """

    def __init__(self, mechanism: Mechanism, names: Sequence[str]) -> None:
        self.names = tuple(names)
        s = mechanism.speeds
        coordinates = ca.vertcat(*(mechanism.joints[name] for name in names))
        slope = ca.jacobian(coordinates, mechanism.z) @ s.inverse_jacobian
        speed = slope @ s.q.u
        state, rates = ca.vertcat(mechanism.z, s.q.u), (s.inverse_jacobian @ s.q.u, s.q.ud)
        acceleration = ca.jtimes(speed, state, ca.vertcat(*rates))
        self.moved_by = np.array(ca.DM(slope.sparsity(), 1.0)) != 0
        self._kernel = BatchKernel(
            ca.vertcat(state, s.q.ud), ca.vertcat(speed, acceleration, ca.vec(ca.densify(slope)))
        )

    def rates(
        self,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
    ) -> JointRates:
        """At some samples of a motion."""
        n = len(self.names)
        out = self._kernel(np.hstack([z, qd, qdd]).T).T
        slope = out[:, 2 * n :].reshape(len(out), -1, n).swapaxes(1, 2)  # CasADi stores columns
        return JointRates(out[:, :n], out[:, n : 2 * n], slope)
