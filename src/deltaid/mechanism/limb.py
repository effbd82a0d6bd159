"""One limb: a drive, then a parallelogram of struts to a joint of the platform.

Frames (docs/conventions.md): the limb's inertial frame L has x outwards, y along the motor axis and
z up; its origin is the world's. Upper arm U at the motor axis, x along the arm, angle 0 horizontal
and outwards, positive downwards; carriage C at the strut's upper joint, parallel to L; strut S at
the elbow, x along the strut, hanging on two revolute joints of which the first is parallel to y.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.vectors import frame, unit
from deltaid.robot.limbs import LimbGeometry


@dataclass(frozen=True)
class Limb:
    """One limb as functions of the point it holds: drive coordinate, poses, reach [m].

    Attributes:
        q: drive coordinate [rad or m].
        R_WL: rotation from the limb's frame L to the world.
        R_LD, r_LD: pose of the driven body, upper arm or carriage.
        R_LS, r_LS: pose of the strut.
        reach: distance by which the point is inside what the limb can reach [m].
    """

    q: ca.SX
    R_WL: Float[np.ndarray, "3 3"]
    R_LD: ca.SX
    r_LD: ca.SX
    R_LS: ca.SX
    r_LS: ca.SX
    reach: ca.SX


def build_limb(point: ca.SX, limb: LimbGeometry) -> Limb:
    """Inverse kinematics and poses of a limb that holds `point` (world, m)."""
    p = ca.mtimes(ca.DM(limb.R_WL.T), point - ca.DM(limb.base))
    return _rotary(p, limb) if limb.drive == "rotary" else _linear(p, limb)


def _rotary(d: ca.SX, limb: LimbGeometry) -> Limb:
    """With d from the motor axis to the held point, the upper arm's direction x_U solves
    d · x_U = κ = (|d|² + L² − l²) / (2 L) in the arm's plane; the working mode picks one of two."""
    L, l = limb.upper_arm, limb.strut
    outwards, lateral, height = d[0], d[1], d[2]
    rho_squared = outwards**2 + height**2
    kappa = (rho_squared + lateral**2 + L**2 - l**2) / (2 * L)
    root = ca.sqrt(rho_squared - kappa**2) * (1 if limb.outwards else -1)
    cos_q = (kappa * outwards - root * height) / rho_squared
    sin_q = -(kappa * height + root * outwards) / rho_squared
    x_U = ca.vertcat(cos_q, 0, -sin_q)
    y_U = ca.SX(ca.DM([0, 1, 0]))
    r_LU = ca.SX(ca.sparsify(ca.DM(_clean(limb.R_WL.T @ limb.base))))
    return Limb(
        q=ca.atan2(sin_q, cos_q),
        R_WL=limb.R_WL,
        R_LD=frame(x_U, y_U, ca.vertcat(sin_q, 0, cos_q)),
        r_LD=r_LU,
        R_LS=_strut_frame((d - L * x_U) / l),
        r_LS=r_LU + L * x_U,
        reach=_rotary_reach(rho_squared, lateral, L, l),
    )


def _linear(p: ca.SX, limb: LimbGeometry) -> Limb:
    """With p from the rail's zero point to the held one and e along the rail, |p − q e| = l gives
    q = e·p ∓ √(l² − |p|² + (e·p)²); outwards is the carriage above."""
    l, e = limb.strut, ca.DM(_clean(limb.rail))
    along = ca.dot(e, p)
    aside_squared = ca.sumsqr(p) - along**2
    q = along - (1 if limb.outwards else -1) * ca.sqrt(l**2 - aside_squared)
    r_LC = ca.SX(ca.sparsify(ca.DM(_clean(limb.R_WL.T @ limb.base)))) + q * ca.sparsify(e)
    return Limb(
        q=q,
        R_WL=limb.R_WL,
        R_LD=ca.SX.eye(3),
        r_LD=r_LC,
        R_LS=_strut_frame((p - q * e) / l),
        r_LS=r_LC,
        reach=l - ca.sqrt(aside_squared),
    )


def _strut_frame(x_S: ca.SX) -> ca.SX:
    """x along the strut, z perpendicular to it and to the limb's y axis."""
    z_S = unit(ca.vertcat(-x_S[2], 0, x_S[0]))
    return frame(x_S, ca.cross(z_S, x_S), z_S)


def _rotary_reach(rho_squared: ca.SX, lateral: ca.SX, L: float, l: float) -> ca.SX:
    """Distance [m] from the held point to the nearest one that the limb cannot reach.

    The limb reaches all points that are a strut l away from some point of the elbow's circle: those
    whose distances to the circle's nearest and farthest point have l between them. Out of reach it
    is minus the distance to the nearest point that can be reached.
    """
    rho = ca.sqrt(rho_squared)
    nearest, farthest = (ca.sqrt(lateral**2 + (rho + sign * L) ** 2) for sign in (-1, 1))
    return ca.fmin(l - nearest, farthest - l)


def elbow(q: ca.SX, limb: LimbGeometry) -> ca.SX:
    """The upper end of the strut for a drive coordinate, in the world [m]."""
    if limb.drive == "rotary":
        in_L = limb.upper_arm * ca.vertcat(ca.cos(q), 0, -ca.sin(q))
    else:
        in_L = q * ca.DM(_clean(limb.rail))
    return ca.DM(limb.base) + ca.DM(limb.R_WL) @ in_L


def mode_margin(q: ca.SX, point: ca.SX, limb: LimbGeometry) -> ca.SX:
    """How far [m] the limb is on the right side of its stretched pose; negative in the other mode.

    Rotary: how far the strut's end lies inwards of the line through the upper arm. Linear: how far
    along the rail the held point lies below the carriage.
    """
    p = ca.mtimes(ca.DM(limb.R_WL.T), point - ca.DM(limb.base))
    if limb.drive == "rotary":
        margin = -p[0] * ca.sin(q) - p[2] * ca.cos(q)
    else:
        margin = ca.dot(ca.DM(limb.rail), p) - q
    return margin if limb.outwards else -margin


def _clean(v: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Rounding to exact zeros, so that the graph has none of it."""
    return np.where(np.abs(v) < 1e-15, 0.0, v)
