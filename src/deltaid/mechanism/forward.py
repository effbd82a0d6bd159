"""Forward kinematics of any mechanism: closed form where there is one, else Newton's method."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import ClosedForm, Mechanism
from deltaid.mechanism.newton import NewtonForward

Samples = Float[np.ndarray, "samples dof"]

# Distance, in m, by which a limb must be in its other working mode to be called so; nearer to the
# stretched limb the pose is singular, whichever side rounding puts it on.
_OTHER_MODE = 1e-9


@dataclass(frozen=True)
class Forward:
    """Task coordinates of drive coordinates, and what is known of each sample.

    Attributes:
        z: NaN where no pose was found.
        closed: whether the loops close.
        in_mode: whether all limbs are in their described working mode, on the home pose's branch.
        gap: strut length missing for the loops to close [m]; NaN where that is not known.
        limb: a limb that is in its other working mode, or −1.
    """

    z: Samples
    closed: Bool[np.ndarray, " samples"]
    in_mode: Bool[np.ndarray, " samples"]
    gap: Float[np.ndarray, " samples"]
    limb: np.ndarray

    def missing(self, i: int) -> str:
        """How far the loops of sample i are from closing, as the end of a sentence."""
        if not np.isfinite(self.gap[i]):
            return ""
        return (
            f": the elbows are too far apart for the struts, by {self.gap[i]:.4g} m of strut length"
        )


ForwardKinematics = Callable[[Samples], Forward]


def forward_kinematics(mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> ForwardKinematics:
    """The forward kinematics of a mechanism.

    Args:
        home: a regular pose z in the described working mode, from which iteration starts.
    """
    if mechanism.forward is not None:
        return _closed_form(mechanism, mechanism.forward)
    return _by_newton(mechanism, home)


def _closed_form(mechanism: Mechanism, form: ClosedForm) -> ForwardKinematics:
    kernel = BatchKernel(mechanism.q_symbols, ca.vertcat(form.z, form.margin, form.modes))
    n = mechanism.dof

    def forward(q: Samples) -> Forward:
        out = kernel(q.T)
        z, margin, modes = out[:n].T, out[n], out[n + 1 :]
        worst = np.argmin(np.nan_to_num(modes, nan=np.inf), axis=0)
        in_mode = ~np.any(modes < -_OTHER_MODE, axis=0)
        return Forward(
            z=z,
            closed=margin > 0,
            in_mode=in_mode,
            gap=np.sqrt(np.maximum(form.strut**2 - margin, 0.0)) - form.strut,
            limb=np.where(in_mode, -1, worst),
        )

    return forward


def _by_newton(mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> ForwardKinematics:
    solver = NewtonForward(mechanism, home)

    def forward(q: Samples) -> Forward:
        found = solver.solve(q)
        closed = np.isfinite(found.z[:, 0])
        return Forward(
            z=found.z,
            closed=closed,
            in_mode=found.on_branch | ~closed,
            gap=np.full(len(q), np.nan),
            limb=np.full(len(q), -1),
        )

    return forward
