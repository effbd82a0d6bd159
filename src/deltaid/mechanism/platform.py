"""Platforms: joints of the limbs, moving bodies, and the platform's own joint.

The task coordinates are z = [r; ψ] for a platform that turns its tool, z = r for one that does not.
Formulas and sources: `robot/platform.py`. A telescope bar (Cardan axle) from base to platform turns
the tool by ψ as well.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from deltaid.mechanism.mechanism import MovingBody
from deltaid.mechanism.rotation import Path, Rotation, Turn, along, fixed, pointing, rotation, skew
from deltaid.mechanism.speeds import Speed
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import I4Platform, Par4Platform, RigidPlatform, Telescope

# Rotation from the first to the second of two equal parts, which are mounted 180° about z apart.
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class PlatformParts:
    """A platform as functions of z.

    Attributes:
        points: for each limb the middle of its strut joints [m].
        bodies: all moving bodies, first the parts that limbs hold.
        joint: coordinate of the platform's own joint, θ [rad] or s [m]; None without one.
        length: how far a part moves with ψ [m/rad]; None where the platform only translates.
        period: turn of ψ [rad] that returns all parts but the tool to the same pose, or None.
    """

    points: tuple[Path, ...]
    bodies: tuple[MovingBody, ...]
    joint: ca.SX | None
    length: float | None
    period: float | None


def build_platform(robot: RobotDescription, z: Path, grown: ca.SX | None = None) -> PlatformParts:
    """The platform of a described robot along a motion of z.

    Args:
        grown: deviation of half the distance between its parts from the described one [m].
    """
    r, platform = z.at[:3], robot.platform
    attachments = [limb.attachment for limb in robot.limb_geometry]
    if isinstance(platform, RigidPlatform):
        part = along(r, z)
        points = tuple(part.shifted(d) for d in attachments)
        return PlatformParts(points, (_body("P", part),), None, None, None)
    joint = z.at[3] / platform.ratio
    towards = ca.sparsify(ca.vertcat(ca.cos(joint), ca.sin(joint), 0))  # u(θ)
    if isinstance(platform, I4Platform):
        half = platform.arm * joint * fixed(platform.direction)
    else:
        half = platform.arm * towards
        if grown is not None:
            half += grown * towards
    parts = along(r + half, z), along(r - half, z)
    points = tuple(
        parts[0 if platform.on_first(i) else 1].shifted(d) for i, d in enumerate(attachments)
    )
    carrier = {"middle": along(r, z), "first": parts[0], "second": parts[1]}[platform.tool_on]
    # Parts between both halves. The motions of a par4's two rods differ by a constant offset, which
    # changes no torque.
    joining = platform.bodies[1:-1]
    count = 2 if isinstance(platform, Par4Platform) else 1
    turn = turn_z(along(joint, z))
    first, second = (_body(platform.bodies[0], part) for part in parts)
    bodies = (
        first,
        replace(second, rotation=replace(second.rotation, R=fixed(HALF_TURN))),
        *(_body(name, along(r, z), turn, count=count) for name in joining),
        _body("EE", carrier.shifted(np.array(platform.tool)), turn_z(z[3])),
    )
    length = platform.arm / abs(platform.ratio)
    period = None if platform.slides else 2 * np.pi * abs(platform.ratio)
    return PlatformParts(points, bodies, joint, length, period)


def turn_z(angle: Path) -> Turn:
    """Rotation about world z."""
    return Turn("z", ca.cos(angle.at), ca.sin(angle.at), angle.rate, angle.acceleration)


def _body(name: str, origin: Path, *turns: Turn, count: int = 1) -> MovingBody:
    return MovingBody(name, count, np.eye(3), rotation(*turns), origin)


def build_telescope(
    z: Path, bar: Telescope, spin: Speed, grown: ca.SX | None = None
) -> tuple[tuple[MovingBody, ...], ca.SX, Speed]:
    """Upper and lower half of the telescope bar with the end effector; the bar's length [m]; its
    angular velocity and acceleration, in its own frame. ψ turns the fork of its base joint about
    world z.

    The bar's z axis points from platform to base. The cross of the base joint turns about the
    fork's x axis and the bar about the cross's y axis, so R_WT = R_z(ψ) R_x(η) R_y(ζ).

    Args:
        z: r and ψ.
        bar: the description.
        spin: symbols for ω and ω̇ of the bar.
        grown: height of its base joint above the described one [m].
    """
    base, r = ca.SX(np.array(bar.base_joint)), along(z.at[:3], z)
    if grown is not None:
        base[2] += grown
    lower = r.shifted(np.array(bar.platform_joint))
    span = base - lower.at
    length = ca.sqrt(ca.sumsqr(span))
    fork = rotation(turn_z(z[3]))
    in_frame = _in_frame(fork, Path(span, -lower.rate, -lower.acceleration))
    turned = rotation(turn_z(z[3]), *pointing("xy", in_frame, along(length, z)))
    R_WT = Rotation(turned.R, spin.u, spin.ud)
    top, eye = Path.still(base), np.eye(3)
    bodies = (
        MovingBody("TU", 1, eye, R_WT, top),
        MovingBody("TL", 1, eye, R_WT, lower),
        MovingBody("EE", 1, eye, fork, r),
    )
    return bodies, length, spin.being(turned.w, turned.alpha)


def _in_frame(frame: Rotation, v: Path) -> Path:
    W, R = skew(frame.w), frame.R
    at = R.T @ v.at
    rate = R.T @ v.rate - W @ at
    acceleration = R.T @ v.acceleration - skew(frame.alpha) @ at - W @ (2 * rate + W @ at)
    return Path(at, rate, acceleration)
