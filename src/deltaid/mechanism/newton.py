"""Forward kinematics by Newton's method, for robots whose loops have no closed form.

z(q) solves Φ(z, q) = 0 (`Mechanism.closure`); a step is z ← z − Φ_z⁻¹ Φ, all samples at once.

1. Samples of a recording lie close together. Every `_STRIDE`-th one is an anchor, which is reached
   from the home pose along a straight line in q, a few steps at a time, so that it stays on the
   home pose's branch. Whole turns of an arm count as none.
2. All others start from their anchor.
3. What has not converged on this branch takes the way of the anchors, once more with finer steps.
4. What is still lost, because that line leaves what the robot can reach, starts from the last
   sample before it that is solved.

A sample counts as solved when its residual is small, every limb is in its described working mode
and det Φ_z has the sign that it has at home: beyond a singularity the robot is on another branch.
Turns of ψ that the drives do not show are taken off: ψ is the one nearest to home's.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.rotation import inverse

Samples = Float[np.ndarray, "samples dof"]

_STRIDE = 32
# Steps along the way from home, coarse and fine, and Newton iterations at each and at the end.
_COARSE, _FINE, _ON_THE_WAY, _AT_THE_END = 6, 60, 2, 8
# How often solved samples are handed on to lost ones.
_HANDED_ON = 4
# Residual [m, rad] below which the loops are closed: far above rounding, far below any length.
_CLOSED = 1e-12
# Distance [m] by which a limb may be in the wrong mode for rounding.
_MODE = 1e-9


@dataclass(frozen=True)
class Solved:
    """Task coordinates and whether each sample was solved on the home pose's branch.

    Attributes:
        z: NaN where no solution was found.
        residual: largest |Φ| [m, rad].
        on_branch: solved, in the described working mode, on this side of singularities.
        limb: a limb of a solution that is in its other working mode, or −1.
    """

    z: Samples
    residual: Float[np.ndarray, " samples"]
    on_branch: Bool[np.ndarray, " samples"]
    limb: Int[np.ndarray, " samples"]


class NewtonForward:
    """z(q) of one mechanism near a home pose.

    Args:
        home: a regular pose in the described working mode, z.

    Raises:
        KinematicsError: the home pose is out of reach.
    """

    def __init__(self, mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> None:
        self._mechanism, self._home = mechanism, home
        z, q = mechanism.z, mechanism.q_symbols
        self._dof = mechanism.dof
        slope = ca.jacobian(mechanism.closure, z)
        step = z - inverse(slope) @ mechanism.closure
        everything = ca.vertcat(z, q)
        self._step = BatchKernel(everything, step)
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

    def solve(self, q: Samples) -> Solved:
        """Solve for all samples; neighbours in the array are taken for neighbours in time."""
        anchors = self._from_home(q[::_STRIDE], _COARSE)
        z = np.repeat(anchors, _STRIDE, axis=0)[: len(q)]
        z = self._iterate(z, q, _AT_THE_END)
        found = self._judge(z, q)
        for steps in (_COARSE, _FINE):
            lost = np.flatnonzero(~found.on_branch)
            if not lost.size:
                break
            z[lost] = self._from_home(q[lost], steps)
            found = self._judge(z, q)
        return self._from_neighbours(q, found)

    def _from_neighbours(self, q: Samples, found: Solved) -> Solved:
        """Carry on from solved samples into lost ones, while that helps."""
        for _ in range(_HANDED_ON):
            solved = found.on_branch
            last = np.maximum.accumulate(np.where(solved, np.arange(len(q)), -1))
            lost = np.flatnonzero(~solved & (last >= 0))
            if not lost.size:
                break
            z = found.z.copy()
            z[lost] = self._iterate(z[last[lost]], q[lost], _AT_THE_END)
            found = self._judge(z, q)
            if not found.on_branch[lost].any():
                break
        return found

    def _from_home(self, q: Samples, steps: int) -> Samples:
        """Follow a straight line in q from the home pose."""
        z = np.repeat(self._home[None], len(q), axis=0)
        way = q - self._q_home
        turns = np.array([middle is not None for middle in self._mechanism.middles])
        way -= 2 * np.pi * turns * np.round(way / (2 * np.pi))
        for share in np.linspace(0, 1, steps + 1)[1:]:
            z = self._iterate(z, self._q_home + share * way, _ON_THE_WAY)
        return self._iterate(z, q, _AT_THE_END)

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
        """Largest residual, determinant and mode margins of each sample, a column each."""
        out = self._check(np.hstack([z, q]).T)
        n = self._dof
        return np.abs(out[:n]).max(axis=0), out[n], out[n + 1 :]

    def _judge(self, z: Samples, q: Samples) -> Solved:
        residual, determinant, modes = self._evaluate(z, q)
        closed, in_mode = residual <= _CLOSED, np.all(modes > -_MODE, axis=0)
        return Solved(
            z=np.where(closed[:, None], z, np.nan),
            residual=residual,
            on_branch=closed & in_mode & (np.sign(determinant) == self._sign),
            limb=np.where(closed & ~in_mode, np.argmin(modes, axis=0), -1),
        )
