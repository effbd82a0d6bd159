"""A planar Delta: two arms in one plane hold a platform that keeps its attitude.

The rods of each limb lie in the plane of motion. A second parallelogram along the arm holds the
bracket at the elbow upright, and the rods hold the platform parallel to the bracket. So the elbow
and the platform point move as in a limb of a spatial Delta that stays in its own plane, and what
moves with the arm is one body: the stabilising bar turns as the arm does, and the bracket, which
does not turn, moves as a point mass at the elbow.
"""

import casadi as ca

import deltaid

LIMBS = deltaid.Limbs(
    azimuth_deg=(0.0, 180.0),
    base_radius=0.12,
    platform_radius=0.04,
    upper_arm=0.28,
    strut=0.60,
)


def mechanism(z):
    """Drives and bodies as CasADi expressions of z = (x, z)."""
    r = ca.vertcat(z[0], 0, z[1])
    bodies = [deltaid.BodyPose("platform", ca.SX.eye(3), r)]
    drives, reach = [], []
    for geometry in LIMBS.geometry():
        limb = deltaid.build_limb(r + ca.DM(geometry.attachment), geometry)
        turn = ca.DM(limb.R_WL)
        drives.append(limb.q)
        reach.append(limb.reach)
        bodies.append(deltaid.BodyPose("arm", turn @ limb.R_LD, turn @ limb.r_LD))
        bodies.append(deltaid.BodyPose("rod", turn @ limb.R_LS, turn @ limb.r_LS, count=2))
    return deltaid.MechanismParts(drives=drives, bodies=bodies, reach=reach)
