"""Forward kinematics of any mechanism: closed form where there is one, as for three limbs that
hold one platform, else Newton's method."""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.limb import elbow, mode_margin
from deltaid.mechanism.mechanism import ClosedForm, Mechanism
from deltaid.mechanism.newton import NewtonForward
from deltaid.robot.limbs import LimbGeometry

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
        limb: a limb in its other working mode; −1 if none is, of a pose beyond a singularity too.
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
            limb=found.limb,
        )

    return forward


def meeting_point(
    q: ca.SX, limbs: tuple[LimbGeometry, ...], *, below: bool
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Platform point from three drive coordinates: the lower or upper point where spheres meet.

    The sphere of limb i has the strut's length as radius and its elbow, moved by the attachment, as
    centre c_i. With a = c_1 − c_0, b = c_2 − c_0, n = a × b, points at distances l_i satisfy
    2 a·x = |a|² + l_0² − l_1² and the same with b, so x = foot ± √margin n/|n|. Returns the point;
    the margin [m²], negative when the spheres do not meet; and each limb's `mode_margin` [m].
    """
    centres = [elbow(q[i], limb) - ca.DM(limb.attachment) for i, limb in enumerate(limbs)]
    a, b = centres[1] - centres[0], centres[2] - centres[0]
    n = ca.cross(a, b)
    n_squared = ca.sumsqr(n)
    squares = [limb.strut**2 for limb in limbs]
    alpha = ca.sumsqr(a) + (squares[0] - squares[1])
    beta = ca.sumsqr(b) + (squares[0] - squares[2])
    foot = (alpha * ca.cross(b, n) + beta * ca.cross(n, a)) / (2 * n_squared)
    margin = squares[0] - ca.sumsqr(foot)
    down = ca.if_else(n[2] > 0, -1.0, 1.0)
    side = down if below else -down
    point = centres[0] + foot + side * ca.sqrt(margin / n_squared) * n
    modes = [mode_margin(q[i], point + ca.DM(l.attachment), l) for i, l in enumerate(limbs)]
    return point, margin, ca.vertcat(*modes)
