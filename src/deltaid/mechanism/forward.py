"""Forward kinematics of any mechanism: in closed form where three limbs hold one platform, else by
Newton's method.

By Newton's method z(q) solves Φ(z, q) = 0 (`Mechanism.closure`); a step is z ← z − Φ_z⁻¹ Φ, all
samples at once.

1. Adjacent samples are close together. Every `_STRIDE`-th one is an anchor, which is reached from
   the home pose along a straight line in q, in a few steps that stay on the home pose's branch.
   Full turns of an arm are removed.
2. All others start from their anchor.
3. Samples without a solution on this branch are reached from home too, then with finer steps.
4. The remaining ones, whose line leaves the robot's reach, start from the last solved sample before
   them.

A sample is solved when its residual is small, every limb is in its described working mode and
det Φ_z has its sign at home, because beyond a singularity the robot is on another branch. ψ is the
value nearest to home's among those that the drives do not distinguish.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.limb import elbow, mode_margin
from deltaid.mechanism.mechanism import ClosedForm, Mechanism
from deltaid.robot.limbs import LimbGeometry

Samples = Float[np.ndarray, "samples dof"]

# Samples between anchors, which are reached from home; the others start at their anchor.
_STRIDE = 32
# Numbers of coarse and fine steps from home, and of Newton iterations at each step and at the end.
COARSE, _FINE, ON_THE_WAY, AT_THE_END = 6, 60, 2, 8
# Largest number of rounds in which solved samples start their unsolved neighbours.
_HANDED_ON = 4
# Residual [m, rad] below which the loops are closed, and distance to the edge of its reach within
# which a limb is stretched: far above rounding, far below any length.
CLOSED = 1e-12
# The same in single precision, whose rounding leaves about 1e-6 of coordinates of a metre.
CLOSED_SINGLE = 1e-5
# A limb is in its other working mode where its mode margin [m] is below minus this; closer to the
# stretched, singular pose rounding decides the sign.
OTHER_MODE = 1e-9


@dataclass(frozen=True)
class Forward:
    """Task coordinates of drive coordinates, with the state of each sample.

    Attributes:
        z: task coordinates; NaN where no pose was found.
        closed: whether the loops close.
        in_mode: whether all limbs are in their described working mode, on the home pose's branch.
        gap: strut length missing for the loops to close [m]; NaN where it is not known.
        limb: index of a limb in its other working mode, or −1; also −1 beyond a singularity.
    """

    z: Samples
    closed: Bool[np.ndarray, " samples"]
    in_mode: Bool[np.ndarray, " samples"]
    gap: Float[np.ndarray, " samples"]
    limb: Int[np.ndarray, " samples"]

    @property
    def on_branch(self) -> Bool[np.ndarray, " samples"]:
        """Which samples are solved, on the home pose's branch."""
        return self.closed & self.in_mode

    def missing(self, i: int) -> str:
        """Strut length that sample i lacks, as the end of a sentence; empty if it is not known."""
        if not np.isfinite(self.gap[i]):
            return ""
        return (
            f": the elbows are too far apart for the struts, by {self.gap[i]:.4g} m of strut length"
        )


class NewtonForward:
    """Forward kinematics z(q) of a mechanism by Newton's method from a home pose.

    Args:
        home: a regular pose z in the described working mode.

    Raises:
        KinematicsError: the home pose is out of reach.
    """

    def __init__(self, mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> None:
        self._mechanism, self._home = mechanism, home
        z, q = mechanism.z, mechanism.q_symbols
        self._dof, everything = mechanism.dof, ca.vertcat(z, q)
        self._step = BatchKernel(everything, z - mechanism.newton_step)
        slope = ca.jacobian(mechanism.closure, z)
        check = ca.vertcat(mechanism.closure, ca.det(slope), mechanism.modes)
        self._check = BatchKernel(everything, check)
        inverse_kinematics = ca.Function("q", [z], [mechanism.q])
        self._q_home = np.asarray(inverse_kinematics(home)).ravel()
        if not np.isfinite(self._q_home).all():
            raise KinematicsError(
                f"the middle of the workspace, z = {np.round(home, 4)}, is out of reach",
                where="workspace",
                cure="forward kinematics starts there; check workspace and the limbs' lengths",
            )
        self._sign = np.sign(self._evaluate(home[None], self._q_home[None])[1][0])

    def solve(self, q: Samples) -> Forward:
        """Solve for all samples; adjacent rows are adjacent in time."""
        anchors = self._from_home(q[::_STRIDE], COARSE)
        z = np.repeat(anchors, _STRIDE, axis=0)[: len(q)]
        z = self._iterate(z, q, AT_THE_END)
        solution = self._judge(z, q)
        for steps in (COARSE, _FINE):
            lost = np.flatnonzero(~solution.on_branch)
            if not lost.size:
                break
            z[lost] = self._from_home(q[lost], steps)
            solution = self._judge(z, q)
        return self._from_neighbours(q, solution)

    def _from_neighbours(self, q: Samples, solution: Forward) -> Forward:
        for _ in range(_HANDED_ON):
            solved = solution.on_branch
            last = np.maximum.accumulate(np.where(solved, np.arange(len(q)), -1))
            lost = np.flatnonzero(~solved & (last >= 0))
            if not lost.size:
                break
            z = solution.z.copy()
            z[lost] = self._iterate(z[last[lost]], q[lost], AT_THE_END)
            solution = self._judge(z, q)
            if not solution.on_branch[lost].any():
                break
        return solution

    def _from_home(self, q: Samples, steps: int) -> Samples:
        z = np.repeat(self._home[None], len(q), axis=0)
        way = q - self._q_home
        turns = np.array([middle is not None for middle in self._mechanism.middles])
        way -= 2 * np.pi * turns * np.round(way / (2 * np.pi))
        for share in np.linspace(0, 1, steps + 1)[1:]:
            z = self._iterate(z, self._q_home + share * way, ON_THE_WAY)
        return self._iterate(z, q, AT_THE_END)

    def _iterate(self, z: Samples, q: Samples, times: int) -> Samples:
        both = np.vstack([z.T, q.T])
        for _ in range(times):
            both[: self._dof] = self._step(both)
        z = both[: self._dof].T
        period = self._mechanism.period
        if period is not None:
            z[:, 3] -= period * np.round((z[:, 3] - self._home[3]) / period)
        return z

    def _evaluate(self, z: Samples, q: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Largest residual, determinant and mode margins of each sample."""
        out = self._check(np.hstack([z, q]).T)
        n = self._dof
        return np.abs(out[:n]).max(axis=0), out[n], out[n + 1 :]

    def _judge(self, z: Samples, q: Samples) -> Forward:
        residual, determinant, modes = self._evaluate(z, q)
        closed, in_mode = residual <= CLOSED, np.all(modes > -OTHER_MODE, axis=0)
        return Forward(
            z=np.where(closed[:, None], z, np.nan),
            closed=closed,
            in_mode=~closed | (in_mode & (np.sign(determinant) == self._sign)),
            gap=np.full(len(q), np.nan),
            limb=np.where(closed & ~in_mode, np.argmin(modes, axis=0), -1),
        )


ForwardKinematics = Callable[[Samples], Forward]


def forward_kinematics(mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> ForwardKinematics:
    """The forward kinematics of a mechanism, in closed form where possible.

    Args:
        home: a regular pose z in the described working mode, from which iteration starts.
    """
    if mechanism.forward is not None:
        return _closed_form(mechanism, mechanism.forward)
    return NewtonForward(mechanism, home).solve


def _closed_form(mechanism: Mechanism, form: ClosedForm) -> ForwardKinematics:
    kernel = BatchKernel(mechanism.q_symbols, ca.vertcat(form.z, form.margin, form.modes))
    n = mechanism.dof

    def forward(q: Samples) -> Forward:
        out = kernel(q.T)
        z, margin, modes = out[:n].T, out[n], out[n + 1 :]
        worst = np.argmin(np.nan_to_num(modes, nan=np.inf), axis=0)
        in_mode = ~np.any(modes < -OTHER_MODE, axis=0)
        return Forward(
            z=z,
            closed=margin > 0,
            in_mode=in_mode,
            gap=np.sqrt(np.maximum(form.strut**2 - margin, 0.0)) - form.strut,
            limb=np.where(in_mode, -1, worst),
        )

    return forward


def meeting_point(
    q: ca.SX, limbs: tuple[LimbGeometry, ...], *, below: bool
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Platform point from three drive coordinates: the lower or upper intersection of spheres.

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
