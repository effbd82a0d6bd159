"""Numeric kinematics of a robot: inverse, forward, Jacobians, poses, with errors that explain."""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import KinematicsError
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import Mechanism, build_mechanism
from deltaid.mechanism.vectors import inverse
from deltaid.robot.description import RobotDescription

Samples = Float[np.ndarray, "samples dof"]

# cond(J) beyond which a pose counts as singular. J mixes rad/m and rad/rad, so a good pose of a
# metre-sized robot has cond(J) below 10; at 1e6 the last six digits of every torque are lost.
SINGULAR_CONDITION = 1e6

# Distance to the edge of a limb's reach, in m, within which the limb counts as stretched: rounding
# alone moves a pose across the edge by 1e-15 m, and q(z) would be NaN.
_EDGE = 1e-12

# Distance, in m, by which an elbow must point inwards to be called so; nearer to the stretched limb
# the pose is singular, whichever side rounding puts the elbow on.
_INWARDS = 1e-9


@dataclass(frozen=True)
class BodyPoses:
    """Poses of one moving body for many samples: R_WB takes link frame B to the world."""

    name: str
    R_WB: Float[np.ndarray, "samples 3 3"]
    r_WB: Float[np.ndarray, "samples 3"]


class Kinematics:
    """Kinematics of a described robot. Arrays have one sample a row; kernels compile when needed.

    z = [x, y, z of the platform point in the world; ψ with a telescope], in m and rad.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self.mechanism: Mechanism = build_mechanism(robot)

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.mechanism.dof

    def inverse(self, z: Samples) -> Samples:
        """Drive coordinates q(z), elbows outwards.

        Raises:
            KinematicsError: a limb cannot reach; names the sample, the limb and the distance.
                Or its arm and strut are in line.
        """
        z = _as_samples(z, self.dof)
        out = self._inverse_kernel(z.T)
        q, reach = out[: self.dof].T, out[self.dof :].T
        self._require_reach(z, reach)
        return q

    def forward(self, q: Samples) -> Samples:
        """Task coordinates z(q), platform below the elbows, in closed form.

        Raises:
            KinematicsError: no platform position closes the loops, its Jacobian is singular, or an
                elbow points inwards.
        """
        q = _as_samples(q, self.dof)
        z, margin, elbows = self._forward(q)
        bad = np.flatnonzero(~(margin > 0))
        if bad.size:
            i = bad[0]
            missing = _excess(self.robot, float(margin[i]))
            raise KinematicsError(
                f"no platform position closes the loops at q = {_numbers(q[i])}: the three "
                f"elbows are too far apart for the struts, by {missing:.4g} m of strut length",
                where=f"sample {i}",
                cure="check the drive angles' unit, sign and zero (0 = arm horizontal, positive "
                "= down), and the lengths in the robot's description",
            )
        self.require_regular(z)
        inwards = np.argwhere(elbows < -_INWARDS)
        if inwards.size:
            i, limb = inwards[0]
            raise KinematicsError(
                f"the elbow of limb {limb + 1} points inwards at q = {_numbers(q[i])}",
                where=f"sample {i}",
                cure="check the drive angles' unit, sign and zero (0 = arm horizontal, positive "
                "= down); a Delta works with its elbows outwards",
            )
        return z

    def forward_unchecked(self, q: Samples) -> tuple[Samples, Float[np.ndarray, " samples"]]:
        """z(q) and the closing margin [m²], not positive where the loops do not close.

        z is NaN where the loops do not close, z and margin where an elbow points inwards.
        """
        z, margin, elbows = self._forward(_as_samples(q, self.dof))
        inwards = np.any(elbows < -_INWARDS, axis=1)
        return np.where(inwards[:, None], np.nan, z), np.where(inwards, np.nan, margin)

    def _forward(
        self, q: Samples
    ) -> tuple[Samples, Float[np.ndarray, " samples"], Float[np.ndarray, "samples limbs"]]:
        out = self._forward_kernel(q.T)
        return out[: self.dof].T, out[self.dof], out[self.dof + 1 :].T

    def jacobian(self, z: Samples) -> Float[np.ndarray, "samples dof dof"]:
        """J = ∂q/∂z, so that q̇ = J ż."""
        out = self._jacobian_kernel(_as_samples(z, self.dof).T)
        return _matrices(out, self.dof)

    def jacobian_rate(self, z: Samples, zd: Samples) -> Float[np.ndarray, "samples dof dof"]:
        """J̇, so that q̈ = J z̈ + J̇ ż."""
        x = np.hstack([_as_samples(z, self.dof), _as_samples(zd, self.dof)]).T
        return _matrices(self._jacobian_rate_kernel(x), self.dof)

    def condition(self, z: Samples) -> Float[np.ndarray, " samples"]:
        """‖J‖_F ‖J⁻¹‖_F / δ: 1 at best, infinite at a singular pose, NaN out of reach."""
        return self._condition_kernel(_as_samples(z, self.dof).T)[0]

    def drive_motion(self, z: Samples, zd: Samples, zdd: Samples) -> tuple[Samples, ...]:
        """(q, q̇, q̈) of a motion given in task coordinates.

        Raises:
            KinematicsError: a pose is out of reach or singular.
        """
        q = self.inverse(z)
        self.require_regular(z)
        J = self.jacobian(z)
        qd = np.einsum("sij,sj->si", J, zd)
        qdd = np.einsum("sij,sj->si", J, zdd)
        qdd += np.einsum("sij,sj->si", self.jacobian_rate(z, zd), zd)
        return q, qd, qdd

    def poses(self, z: Samples) -> tuple[BodyPoses, ...]:
        """Poses of all moving bodies, limb by limb as in `Mechanism.bodies`."""
        out = self._pose_kernel(_as_samples(z, self.dof).T)
        result = []
        for i, body in enumerate(self.mechanism.bodies):
            block = out[12 * i : 12 * i + 12].T
            R_LB = block[:, :9].reshape(-1, 3, 3).swapaxes(1, 2)  # CasADi stores columns
            result.append(BodyPoses(body.name, body.R_WL @ R_LB, block[:, 9:] @ body.R_WL.T))
        return tuple(result)

    def require_regular(self, z: Samples) -> None:
        """Raise KinematicsError when a pose is singular."""
        condition = self.condition(z)
        bad = np.flatnonzero(~(condition < SINGULAR_CONDITION))
        if bad.size:
            i = bad[0]
            raise KinematicsError(
                f"the pose z = {_numbers(z[i])} is singular: drives and platform lose their "
                "one-to-one relation (an arm and its struts in line, or the struts coplanar)",
                where=f"sample {i}",
                cure="keep the motion away from the edge of the workspace",
            )

    def _require_reach(self, z: Samples, reach: Float[np.ndarray, "samples limbs"]) -> None:
        bad = np.argwhere(~(reach > _EDGE))
        if bad.size:
            i, limb = bad[0]
            if abs(reach[i, limb]) <= _EDGE:
                raise KinematicsError(
                    f"the pose z = {_numbers(z[i])} is singular: arm and struts of limb {limb + 1} "
                    "lie in line",
                    where=f"sample {i}",
                    cure="keep the motion away from the edge of the workspace",
                )
            raise KinematicsError(
                f"limb {limb + 1} cannot reach the pose z = {_numbers(z[i])}: "
                f"{-reach[i, limb]:.4g} m are missing",
                where=f"sample {i}",
                cure="platform positions are in metres with z up, so they have z < 0",
            )

    @cached_property
    def _inverse_kernel(self) -> BatchKernel:
        m = self.mechanism
        return BatchKernel(m.z, ca.vertcat(m.q, m.reach))

    @cached_property
    def _forward_kernel(self) -> BatchKernel:
        m = self.mechanism
        return BatchKernel(m.q_symbols, ca.vertcat(m.forward, m.forward_margin, m.forward_elbows))

    @cached_property
    def _jacobian_kernel(self) -> BatchKernel:
        m = self.mechanism
        return BatchKernel(m.z, ca.jacobian(m.q, m.z))

    @cached_property
    def _jacobian_rate_kernel(self) -> BatchKernel:
        m = self.mechanism
        zd = ca.SX.sym("zd", m.dof)
        J = ca.jacobian(m.q, m.z)
        return BatchKernel(ca.vertcat(m.z, zd), ca.jtimes(ca.vec(ca.densify(J)), m.z, zd))

    @cached_property
    def _condition_kernel(self) -> BatchKernel:
        m = self.mechanism
        J = ca.jacobian(m.q, m.z)
        squared = ca.sumsqr(J) * ca.sumsqr(inverse(J))
        return BatchKernel(m.z, ca.sqrt(squared) / m.dof)

    @cached_property
    def _pose_kernel(self) -> BatchKernel:
        m = self.mechanism
        columns = [ca.vertcat(ca.vec(ca.densify(b.R_LB)), ca.densify(b.r_LB)) for b in m.bodies]
        return BatchKernel(m.z, ca.vertcat(*columns))


def _as_samples(x: Float[np.ndarray, "..."], dof: int) -> Samples:
    """One or many samples as rows."""
    rows = np.atleast_2d(np.asarray(x, dtype=float))
    if rows.shape[-1] != dof or rows.ndim != 2:
        raise KinematicsError(f"expected arrays of shape (samples, {dof}), got {rows.shape}")
    return rows


def _matrices(out: Float[np.ndarray, "entries samples"], dof: int) -> np.ndarray:
    return out.T.reshape(-1, dof, dof).swapaxes(1, 2)  # CasADi stores columns


def _excess(robot: RobotDescription, margin: float) -> float:
    """Strut length missing for the three spheres to meet, from the margin l² − ρ²."""
    l = robot.limbs.strut
    return float(np.sqrt(max(l**2 - margin, 0.0)) - l)


def _numbers(x: Float[np.ndarray, " n"]) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in x) + "]"
