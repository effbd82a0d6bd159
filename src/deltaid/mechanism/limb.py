"""A limb: a drive, then a parallelogram of struts to a joint of the platform.

Frames (docs/conventions.md): the limb's inertial frame L has x outwards, y along the motor axis and
z up; its origin is the world's. The upper arm's frame U is at the motor axis, x along the arm;
angle 0 is horizontal and outwards, positive downwards. The carriage's frame C is at the strut's
upper joint, parallel to L. The strut's frame S is at the elbow, x along the strut; of its two
revolute joints the first is parallel to y.
"""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.mechanism.growth import LimbGrowth
from deltaid.mechanism.mechanism import LimbBodies, MovingBody
from deltaid.mechanism.rotation import Path, Turn, fixed, pointing, reciprocal, rotation, skew
from deltaid.mechanism.speeds import Speed
from deltaid.robot.limbs import LimbGeometry

_Length = float | ca.SX


@dataclass(frozen=True)
class Limb:
    """A limb as functions of its platform joint: drive coordinate, poses, reach [m].

    Attributes:
        q: drive coordinate [rad or m].
        R_WL: rotation from the limb's frame L to the world.
        R_LD, r_LD: pose of the driven body, upper arm or carriage.
        R_LS, r_LS: pose of the strut.
        reach: distance by which the platform joint is inside the limb's reach [m].
    """

    q: ca.SX
    R_WL: Float[np.ndarray, "3 3"]
    R_LD: ca.SX
    r_LD: ca.SX
    R_LS: ca.SX
    r_LS: ca.SX
    reach: ca.SX


@dataclass(frozen=True)
class LimbMotion:
    """A limb along a motion of its platform joint a and its drive.

    The loop |a − E(q)|² = l² through the elbow E gives, with s = a − E(q) and E′ = dE/dq,

        sᵀ ȧ = (s · E′) q̇,    sᵀ ä = (s · E′) q̈ + s · E″ q̇² − |ṡ|².

    Attributes:
        q: drive coordinate.
        bodies: driven body and strut.
        s: the strut's vector in the world [m].
        gain: s · E′.
        bias: s · ä at q̈ = 0, s · E″ q̇² − |ṡ|².
        swing: rates of the strut's turns about y of L and then about its own z.
        reach: as in `Limb` [m].
    """

    q: ca.SX
    bodies: LimbBodies
    s: ca.SX
    gain: ca.SX
    bias: ca.SX
    swing: Speed
    reach: ca.SX


def build_limb(point: ca.SX, limb: LimbGeometry, middle: float = 0.0) -> Limb:
    """Inverse kinematics and poses of a limb with its platform joint at `point` (world, m).

    A rotary drive's angle is continuous within 180° of `middle` [rad].
    """
    at_rest = Speed.named("", 1), Speed.named("", 2)
    motion = limb_motion(Path.still(point), limb, ("", ""), *at_rest, middle)
    driven, strut = motion.bodies.driven, motion.bodies.strut
    poses = (driven.rotation.R, driven.origin.at, strut.rotation.R, strut.origin.at)
    return Limb(motion.q, limb.R_WL, *poses, motion.reach)


def limb_motion(
    point: Path,
    limb: LimbGeometry,
    names: tuple[str, str],
    drive: Speed,
    swing: Speed,
    middle: float,
    grown: LimbGrowth | None = None,
) -> LimbMotion:
    """Inverse kinematics and motion of a limb.

    Args:
        point: platform joint, in the world [m].
        names: of the driven body and the strut.
        drive: q̇ and q̈ as symbols.
        swing: rates and accelerations of the strut's two angles as symbols.
        middle: angle of a rotary drive opposite to which its coordinate jumps by a turn [rad].
        grown: deviations of its lengths from the described ones.
    """
    point, lengths, turned = _grown(point, limb, grown)
    R_LW, origin = turned.T @ fixed(limb.R_WL.T), turned.T @ fixed(limb.R_WL.T @ limb.base)
    d, qd, qdd = R_LW @ (point.at - fixed(limb.base)), drive.u, drive.ud
    rotary = limb.drive == "rotary"
    solved = _rotary(d, limb, lengths, middle) if rotary else _linear(d, limb, lengths[1])
    bias = solved.curve * qd**2
    elbow = Path(origin + solved.elbow, solved.slope * qd, solved.slope * qdd + bias)
    s = Path(d - solved.elbow, R_LW @ point.rate - elbow.rate,
             R_LW @ point.acceleration - elbow.acceleration)  # fmt: skip
    turns = pointing("yz", s, Path.still(ca.SX(lengths[1])))
    strut = rotation(
        *(replace(t, rate=swing.u[k], acceleration=swing.ud[k]) for k, t in enumerate(turns))
    )
    if rotary:
        arm = rotation(Turn("y", solved.cos, solved.sin, qd, qdd))
        driven = MovingBody(names[0], 1, limb.R_WL, arm, Path.still(origin))
    else:
        driven = MovingBody(names[0], 1, limb.R_WL, rotation(), elbow)
    return LimbMotion(
        q=solved.q,
        bodies=LimbBodies(
            driven.turned(turned),
            MovingBody(names[1], limb.struts, limb.R_WL, strut, elbow).turned(turned),
            point.at,
            lengths[1],
        ),
        s=R_LW.T @ s.at,
        gain=ca.dot(s.at, solved.slope),
        bias=ca.dot(s.at, bias) - ca.sumsqr(s.rate),
        swing=swing.being(
            ca.vertcat(*(turn.rate for turn in turns)),
            ca.vertcat(*(turn.acceleration for turn in turns)),
        ),
        reach=solved.reach,
    )


def _grown(
    point: Path, limb: LimbGeometry, grown: LimbGrowth | None
) -> tuple[Path, tuple[_Length, _Length], ca.SX]:
    """Platform joint, lengths of arm and strut, and rotation of the limb's frame."""
    if grown is None:
        return point, (limb.upper_arm, limb.strut), ca.SX.eye(3)
    point = replace(point, at=point.at + fixed(limb.R_WL[:, 0]) * grown.seat)
    lengths = limb.upper_arm + grown.arm, limb.strut + grown.strut
    if grown.place is None or grown.turn is None:
        return point, lengths, ca.SX.eye(3)
    point = replace(point, at=point.at + fixed(limb.R_WL[:, 1:]) @ grown.place)
    return point, lengths, ca.SX.eye(3) + skew(grown.turn)  # first order is enough for slopes


@dataclass(frozen=True)
class _Drive:
    """A limb's solution for a platform joint: drive coordinate and, for a rotary drive, its cosine
    and sine; elbow from the base point in L, E′, E″; reach."""

    q: ca.SX
    cos: ca.SX
    sin: ca.SX
    elbow: ca.SX
    slope: ca.SX
    curve: ca.SX
    reach: ca.SX


def _rotary(
    d: ca.SX, limb: LimbGeometry, lengths: tuple[_Length, _Length], middle: float
) -> _Drive:
    """With d from the motor axis to the platform joint, the upper arm's direction x_U solves
    d · x_U = κ = (|d|² + L² − l²) / (2 L) in the arm's plane; the working mode selects a root."""
    L, l = lengths
    outwards, lateral, height = d[0], d[1], d[2]
    rho_squared = outwards**2 + height**2
    kappa = (rho_squared + (lateral**2 + (L**2 - l**2))) * (0.5 / L)
    root = ca.sqrt(rho_squared - kappa**2) * limb.root
    share = reciprocal(rho_squared)
    cos_q = (kappa * outwards - root * height) * share
    sin_q = -(kappa * height + root * outwards) * share
    arm = ca.sparsify(ca.vertcat(L * cos_q, 0, -L * sin_q))
    return _Drive(
        q=_angle(cos_q, sin_q, middle),
        cos=cos_q,
        sin=sin_q,
        elbow=arm,
        slope=ca.sparsify(ca.vertcat(-L * sin_q, 0, -L * cos_q)),
        curve=-arm,
        reach=_rotary_reach(rho_squared, lateral, L, l),
    )


def _angle(cos: ca.SX, sin: ca.SX, middle: float) -> ca.SX:
    if middle == 0:
        return ca.atan2(sin, cos)
    c, s = np.cos(middle), np.sin(middle)
    return middle + ca.atan2(c * sin - s * cos, c * cos + s * sin)


def _linear(p: ca.SX, limb: LimbGeometry, l: _Length) -> _Drive:
    """With p from the rail's zero point to the platform joint and e along the rail, |p − q e| = l
    gives q = e·p ∓ √(l² − |p|² + (e·p)²); −, the carriage above, where `limb.root` is 1."""
    e = fixed(limb.rail)
    along = ca.dot(e, p)
    aside_squared = ca.sumsqr(p) - along**2
    q = along - limb.root * ca.sqrt(l**2 - aside_squared)
    none = ca.SX(3, 1)
    return _Drive(q, ca.SX(1), ca.SX(0), q * e, e, none, l - ca.sqrt(aside_squared))


def _rotary_reach(rho_squared: ca.SX, lateral: ca.SX, L: _Length, l: _Length) -> ca.SX:
    """Distance [m] from the platform joint to the nearest point out of reach.

    The limb reaches all points at a distance l from some point of the elbow's circle: l is between
    their distances to the circle's nearest and farthest point. Out of reach the result is minus the
    distance to the nearest point within reach.
    """
    rho = ca.sqrt(rho_squared)
    nearest, farthest = (ca.sqrt(lateral**2 + (rho + sign * L) ** 2) for sign in (-1, 1))
    return ca.fmin(l - nearest, farthest - l)


def elbow(q: ca.SX, limb: LimbGeometry) -> ca.SX:
    """Upper end of the strut for a drive coordinate, in the world [m]."""
    if limb.drive == "rotary":
        in_L = limb.upper_arm * ca.vertcat(ca.cos(q), 0, -ca.sin(q))
    else:
        in_L = q * fixed(limb.rail)
    return ca.DM(limb.base) + ca.DM(limb.R_WL) @ in_L


def mode_margin(q: ca.SX, point: ca.SX, limb: LimbGeometry) -> ca.SX:
    """Distance [m] of the limb from its stretched pose; negative in the other working mode.

    Rotary: how far the platform joint lies inwards of the line through the upper arm. Linear: how
    far along the rail it lies below the carriage.
    """
    p = ca.mtimes(ca.DM(limb.R_WL.T), point - ca.DM(limb.base))
    if limb.drive == "rotary":
        margin = -p[0] * ca.sin(q) - p[2] * ca.cos(q)
    else:
        margin = ca.dot(ca.DM(limb.rail), p) - q
    return limb.root * margin
