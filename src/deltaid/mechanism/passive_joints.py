"""How fast the joints without a drive move, along a motion of the drives."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import Mechanism


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
