"""The parts of a rotary Delta: limb with parallelogram, telescope bar, closed-form kinematics.

Frames (docs/conventions.md): world W with z up, origin at the base centre; upper arm U at the motor
axis, x along the arm, y the motor axis, angle 0 horizontal and outwards, positive downwards; strut
S at the elbow, x along the strut, hanging on two revolute joints of which the first is parallel to
the motor axis.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.vectors import frame, rotation_z, unit
from deltaid.robot.description import Limbs, Telescope


@dataclass(frozen=True)
class Limb:
    """One limb as functions of the platform point: drive angle, poses, reach [m].

    Poses are resolved in the limb's own inertial frame L: x outwards, y along the motor axis, z up.
    """

    q: ca.SX
    R_WL: Float[np.ndarray, "3 3"]
    R_LU: ca.SX
    r_LU: ca.SX
    R_LS: ca.SX
    r_LS: ca.SX
    reach: ca.SX


@dataclass(frozen=True)
class TelescopeBar:
    """The telescope bar as functions of r and ψ: both parts' poses, end effector, length [m]."""

    R_WT: ca.SX
    r_WTU: ca.SX
    r_WTL: ca.SX
    R_WE: ca.SX
    length: ca.SX


def limb(r: ca.SX, azimuth_deg: float, limbs: Limbs) -> Limb:
    """Inverse kinematics and poses of a limb that leaves the base in direction `azimuth_deg`.

    With d from the motor axis to the platform's joint, the upper arm's direction x_U solves
    d · x_U = κ = (|d|² + L² − l²) / (2 L) in the arm's plane; of the two solutions the elbow that
    points outwards is taken.
    """
    R_WL = limb_frame(azimuth_deg)
    L, l = limbs.upper_arm, limbs.strut
    d = R_WL.T @ r - ca.DM([limbs.base_radius - limbs.platform_radius, 0, 0])
    outwards, lateral, height = d[0], d[1], d[2]
    rho_squared = outwards**2 + height**2
    kappa = (rho_squared + lateral**2 + L**2 - l**2) / (2 * L)
    root = ca.sqrt(rho_squared - kappa**2)
    cos_q = (kappa * outwards - root * height) / rho_squared
    sin_q = -(kappa * height + root * outwards) / rho_squared
    x_U = ca.vertcat(cos_q, 0, -sin_q)
    y_U = ca.SX(ca.DM([0, 1, 0]))
    x_S = (d - L * x_U) / l
    z_S = unit(ca.vertcat(-x_S[2], 0, x_S[0]))  # perpendicular to the strut and the motor axis
    r_LU = ca.SX(ca.DM([limbs.base_radius, 0, 0]))
    return Limb(
        q=ca.atan2(sin_q, cos_q),
        R_WL=R_WL,
        R_LU=frame(x_U, y_U, ca.vertcat(sin_q, 0, cos_q)),
        r_LU=r_LU,
        R_LS=frame(x_S, ca.cross(z_S, x_S), z_S),
        r_LS=r_LU + L * x_U,
        reach=_reach(rho_squared, lateral, L, l),
    )


def _reach(rho_squared: ca.SX, lateral: ca.SX, L: float, l: float) -> ca.SX:
    """Distance [m] from the platform's joint to the nearest point that the limb cannot reach.

    The limb reaches all points that are a strut l away from some point of the elbow's circle: those
    whose distances to the circle's nearest and farthest point have l between them. Out of reach it
    is minus the distance to the nearest point that can be reached.
    """
    rho = ca.sqrt(rho_squared)
    nearest, farthest = (ca.sqrt(lateral**2 + (rho + sign * L) ** 2) for sign in (-1, 1))
    return ca.fmin(l - nearest, farthest - l)


def telescope(r: ca.SX, psi: ca.SX, bar: Telescope) -> TelescopeBar:
    """Poses of the telescope bar; ψ turns the fork of its base joint about world z.

    The bar's z axis points from platform to base. The cross of the base joint turns about the
    fork's x axis and the bar about the cross's y axis, so y is perpendicular to both.
    """
    r_WTU, r_WTL = ca.SX(np.array(bar.base_joint)), r + np.array(bar.platform_joint)
    span = r_WTU - r_WTL
    R_WE = rotation_z(psi)
    z_T = unit(span)
    y_T = unit(ca.cross(z_T, R_WE[:, 0]))
    return TelescopeBar(
        R_WT=frame(ca.cross(y_T, z_T), y_T, z_T),
        r_WTU=r_WTU,
        r_WTL=r_WTL,
        R_WE=R_WE,
        length=ca.sqrt(ca.sumsqr(span)),
    )


def forward_kinematics(q: ca.SX, limbs: Limbs) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Platform point from three drive angles: intersection of three spheres, the lower one.

    The sphere of limb i has the strut's length as radius and its elbow, moved inwards by the
    platform radius, as centre c_i. Returns the point; a margin [m²], negative when the spheres do
    not meet; and for each limb how far [m] the strut's end lies inwards of the line through the
    upper arm, negative when the elbow points inwards.
    """
    frames = [ca.SX(limb_frame(azimuth)) for azimuth in limbs.azimuth_deg]
    offset = limbs.base_radius - limbs.platform_radius
    arms = [ca.vertcat(ca.cos(q[i]), 0, -ca.sin(q[i])) for i in range(len(frames))]
    centres = [
        R_WL @ (ca.vertcat(offset, 0, 0) + limbs.upper_arm * x_U)
        for R_WL, x_U in zip(frames, arms, strict=True)
    ]
    a, b = centres[1] - centres[0], centres[2] - centres[0]
    n = ca.cross(a, b)
    n_squared = ca.sumsqr(n)
    to_circumcentre = (ca.sumsqr(a) * ca.cross(b, n) + ca.sumsqr(b) * ca.cross(n, a)) / (
        2 * n_squared
    )
    margin = limbs.strut**2 - ca.sumsqr(to_circumcentre)
    down = ca.if_else(n[2] > 0, -1.0, 1.0)
    point = centres[0] + to_circumcentre + down * ca.sqrt(margin / n_squared) * n
    inwards = []
    for R_WL, x_U in zip(frames, arms, strict=True):
        d = R_WL.T @ point - ca.DM([offset, 0, 0])
        inwards.append(d[0] * x_U[2] - d[2] * x_U[0])
    return point, margin, ca.vertcat(*inwards)


def limb_frame(azimuth_deg: float) -> Float[np.ndarray, "3 3"]:
    """Rotation R_WL from a limb's frame (x outwards, y along the motor axis, z up) to the world."""
    c, s = np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
