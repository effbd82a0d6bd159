"""The telescope bar (Cardan axle) from base to platform, which turns the tool by ψ."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.mechanism.mechanism import MovingBody, TelescopeBodies
from deltaid.mechanism.platform import turn_z
from deltaid.mechanism.rotation import Path, Rotation, along, pointing, rotation, skew
from deltaid.mechanism.speeds import Speed
from deltaid.robot.platform import Telescope


@dataclass(frozen=True)
class TelescopeMotion:
    """The telescope bar along a motion of r and ψ.

    Attributes:
        bodies: both halves and the end effector.
        length: of the bar [m].
        spin: the bar's angular velocity and acceleration, in its own frame.
    """

    bodies: TelescopeBodies
    length: ca.SX
    spin: Speed


def build_telescope(
    z: Path, bar: Telescope, spin: Speed, grown: ca.SX | None = None
) -> TelescopeMotion:
    """Motion of the telescope bar; ψ turns the fork of its base joint about world z.

    The bar's z axis points from platform to base. The cross of the base joint turns about the
    fork's x axis and the bar about the cross's y axis, so R_WT = R_z(ψ) R_x(η) R_y(ζ).

    Args:
        z: r and ψ.
        bar: the description.
        spin: symbols for ω and ω̇ of the bar.
        grown: a symbol that its base joint stands higher than described by [m].
    """
    base, r = ca.SX(np.array(bar.base_joint)), along(z.at[:3], z)
    if grown is not None:
        base[2] += grown
    lower = r.shifted(np.array(bar.platform_joint))
    span = base - lower.at
    length = ca.sqrt(ca.sumsqr(span))
    fork = rotation(turn_z(z[3]))
    seen = _seen(fork, Path(span, -lower.rate, -lower.acceleration))
    stretch = along(length, z)
    turned = rotation(turn_z(z[3]), *pointing("xy", seen, stretch))
    R_WT = Rotation(turned.R, spin.u, spin.ud)
    top, eye = Path.still(base), np.eye(3)
    bodies = TelescopeBodies(
        upper=MovingBody("TU", 1, eye, R_WT, top),
        lower=MovingBody("TL", 1, eye, R_WT, lower),
        tool=MovingBody("EE", 1, eye, fork, r),
    )
    return TelescopeMotion(bodies, length, spin.being(turned.w, turned.alpha))


def _seen(frame: Rotation, v: Path) -> Path:
    """A vector and its derivatives as seen from a turning frame."""
    W, R = skew(frame.w), frame.R
    at = R.T @ v.at
    rate = R.T @ v.rate - W @ at
    acceleration = R.T @ v.acceleration - skew(frame.alpha) @ at - W @ (2 * rate + W @ at)
    return Path(at, rate, acceleration)
