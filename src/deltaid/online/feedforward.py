"""Torques of a motion with the load that is held and with friction as it is now."""

from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import BatchKernel
from deltaid.model.model import Model
from deltaid.online.knowledge import Knowledge


class FeedForward:
    """τ(z, q̇, q̈, load, friction) of one model, as the drives are commanded.

    Attributes:
        z, qd, qdd, load, friction: symbols: the motion, and what a cycle gives of both.
        tau: the expression; its friction changes direction at a stroke where the motion does, not
            where a noisy measurement does.
    """

    def __init__(self, model: Model, known: Knowledge) -> None:
        e, layout = model.dynamics.equations, model.layout
        self.z, self.qd, self.qdd = e.z, e.qd, e.qdd
        self.load = ca.SX.sym("load", len(known.entries.shown))
        self.friction = ca.SX.sym("friction", len(known.followed))
        p, first = ca.SX(model.p), layout.body(known.entries.body).start
        for i, k in enumerate(known.followed):
            p[k] = self.friction[i]
        for i, k in enumerate(known.entries.shown):
            p[first + k] += self.load[i]
        tau = ca.substitute([e.torque], [e.p], [p])[0]
        self.tau: ca.SX = tau / ca.SX(model.gains)
        self._kinematics = model.dynamics.kinematics

    def __call__(
        self,
        q: Float[np.ndarray, " dof"],
        qd: Float[np.ndarray, " dof"],
        qdd: Float[np.ndarray, " dof"],
        load: Float[np.ndarray, " entries"],
        friction: Float[np.ndarray, " coefficients"],
    ) -> Float[np.ndarray, " dof"]:
        """Torques for one instant of a motion.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        z = self._kinematics.forward(q)
        x = np.concatenate([z, qd, qdd])[:, None]
        return self._kernel(x, uniform=np.concatenate([load, friction]))[:, 0]

    @cached_property
    def _kernel(self) -> BatchKernel:
        motion = ca.vertcat(self.z, self.qd, self.qdd)
        return BatchKernel(motion, self.tau, uniform=ca.vertcat(self.load, self.friction))
