"""A machine that is not in the catalogue: two half platforms that move along z and turn a screw.

The geometry is that of the Heli4 (Krut, Company, Nabat, Pierrot 2006): four limbs of a rotary
Delta hold two half platforms, limbs 1 and 4 the upper one and 2 and 3 the lower one. Half their
distance s apart from the platform point, along z, they turn the tool by ψ = k s. What the file
defines is one function, from the task coordinates z = (x, y, z, ψ) to everything that moves.
"""

import casadi as ca
import numpy as np

import deltaid

LIMBS = deltaid.Limbs(
    azimuth_deg=(45.0, -45.0, 135.0, -135.0),
    base_radius=0.15,
    platform_radius=0.05,
    upper_arm=0.30,
    strut=0.70,
)
UPPER = (0, 3)  # limbs that hold the upper half platform
SCREW = 60.0  # k [rad/m]


def mechanism(z):
    """Drives, bodies and joints as CasADi expressions of z."""
    r, psi = z[:3], z[3]
    s = psi / SCREW
    half = 0.5 * s * ca.DM([0, 0, 1])
    drives, reach = [], []
    bodies = [
        deltaid.BodyPose("half", ca.SX.eye(3), r + half),
        deltaid.BodyPose("half", ca.SX.eye(3), r - half),
        deltaid.BodyPose("tool", rotation_z(psi), r - half),
    ]
    for i, geometry in enumerate(LIMBS.geometry()):
        held = r + (half if i in UPPER else -half) + ca.DM(geometry.attachment)
        limb = deltaid.build_limb(held, geometry)
        drives.append(limb.q)
        reach.append(limb.reach)
        turn = ca.DM(limb.R_WL)
        bodies.append(deltaid.BodyPose("arm", turn @ limb.R_LD, turn @ limb.r_LD))
        bodies.append(deltaid.BodyPose("rod", turn @ limb.R_LS, turn @ limb.r_LS, count=2))
    return deltaid.MechanismParts(
        drives=drives,
        bodies=bodies,
        joints={"screw": s},
        reach=reach,
        turn_length=0.5 / SCREW,
    )


def rotation_z(angle):
    """Rotation about the third axis."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.SX(np.array([[0, 0, 1]])))
