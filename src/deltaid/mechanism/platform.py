"""Platforms: the points that limbs hold, the moving bodies, and the platform's own joint.

The task coordinates are z = [r; ψ] for a platform that turns its tool, z = r for one that does not.
Formulas and sources: `robot/platform.py`.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.mechanism.vectors import rotation_z
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform, RigidPlatform


@dataclass(frozen=True)
class PlatformBody:
    """A body of the platform: name, how many share its motion, rotation and origin in the world."""

    name: str
    count: int
    R_WB: ca.SX
    r_WB: ca.SX


@dataclass(frozen=True)
class PlatformParts:
    """A platform as functions of z.

    Attributes:
        points: for each limb the middle of its strut joints [m].
        bodies: all moving bodies.
        joint: coordinate of the platform's own joint, θ [rad] or s [m]; None without one.
        length: how far a part moves with ψ [m/rad]; None where the platform only translates.
        period: turn of ψ [rad] after which all parts but the tool are where they were, or None.
    """

    points: tuple[ca.SX, ...]
    bodies: tuple[PlatformBody, ...]
    joint: ca.SX | None
    length: float | None
    period: float | None


def build_platform(robot: RobotDescription, z: ca.SX) -> PlatformParts:
    """The platform of a described robot."""
    r, platform = z[:3], robot.platform
    attachments = [ca.DM(limb.attachment) for limb in robot.limb_geometry]
    if isinstance(platform, RigidPlatform):
        points = tuple(r + d for d in attachments)
        return PlatformParts(points, (PlatformBody("P", 1, ca.SX.eye(3), r),), None, None, None)
    psi = z[3]
    joint = psi / platform.ratio
    half = _half(platform, joint)
    parts = (r + half, r - half)
    points = tuple(parts[0 if platform.on_first(i) else 1] + d for i, d in enumerate(attachments))
    carrier = {"middle": r, "first": parts[0], "second": parts[1]}[platform.tool_on]
    tool = PlatformBody("EE", 1, rotation_z(psi), carrier + ca.DM(np.array(platform.tool)))
    bodies = (*_bodies(platform, parts, r, joint), tool)
    length = _half_length(platform) / abs(platform.ratio)
    period = None if platform.slides else 2 * np.pi * abs(platform.ratio)
    return PlatformParts(points, bodies, joint, length, period)


def _half(platform: H4Platform | Par4Platform | I4Platform, joint: ca.SX) -> ca.SX:
    """From the platform point to the point of the first part."""
    if isinstance(platform, I4Platform):
        angle = np.deg2rad(platform.direction_deg)
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        return _half_length(platform) * joint * ca.sparsify(ca.DM(direction.round(15)))
    return _half_length(platform) * rotation_z(joint)[:, 0]


def _half_length(platform: H4Platform | Par4Platform | I4Platform) -> float:
    """How far a part moves with the platform's own joint: h or L/2 [m], or one half."""
    match platform:
        case H4Platform():
            return platform.half_length
        case Par4Platform():
            return 0.5 * platform.length
        case I4Platform():
            return 0.5


def _bodies(
    platform: H4Platform | Par4Platform | I4Platform,
    parts: tuple[ca.SX, ca.SX],
    r: ca.SX,
    joint: ca.SX,
) -> tuple[PlatformBody, ...]:
    """Both parts, which only translate, and what joins them."""
    match platform:
        case H4Platform():
            joining = (PlatformBody("MB", 1, rotation_z(joint), r),)
        case Par4Platform():
            # Both rods move alike but for where they are, which no torque shows.
            joining = (PlatformBody("R", 2, rotation_z(joint), r),)
        case I4Platform():
            joining = ()
    name = platform.bodies[0]
    return (*(PlatformBody(name, 1, ca.SX.eye(3), part) for part in parts), *joining)
