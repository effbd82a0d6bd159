"""Appearance of a robot in simulators: simple massless shapes on the bodies of its tree.

Joints, ends of arms and struts, seats and the tool are to scale; dimensions that are not described
(thickness, width, the base) are in proportion to the length of the struts.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.tree import ZERO, I, Tree, Vector, X, Z
from deltaid.model.model import Model
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import I4Platform, RigidPlatform

# Red, green, blue and opacity of each colour.
COLOURS: dict[str, tuple[float, float, float, float]] = {
    "base": (0.80, 0.82, 0.85, 1.0),
    "motor": (0.20, 0.22, 0.26, 1.0),
    "arm": (0.92, 0.42, 0.10, 1.0),
    "strut": (0.13, 0.14, 0.16, 1.0),
    "steel": (0.66, 0.69, 0.73, 1.0),
    "platform": (0.24, 0.45, 0.68, 1.0),
    "tool": (0.95, 0.72, 0.15, 1.0),
}


@dataclass(frozen=True)
class NamedShape:
    """A shape on a body of the tree, in its link frame; the body '' is the world."""

    body: str
    name: str
    colour: str


@dataclass(frozen=True)
class Rod(NamedShape):
    """A cylinder between two points, with round ends where the format allows them."""

    start: Vector
    end: Vector
    radius: float
    round: bool = True


@dataclass(frozen=True)
class Ball(NamedShape):
    """A sphere about its centre."""

    centre: Vector
    radius: float


@dataclass(frozen=True)
class BoxShape(NamedShape):
    """A box with half lengths along its own axes."""

    centre: Vector
    R: Float[np.ndarray, "3 3"]
    half: Vector


Shape = Rod | Ball | BoxShape


def thickness(subject: Model) -> float:
    """The length that all thicknesses are proportional to: the longest strut [m]."""
    return max(limb.strut for limb in subject.robot.limb_geometry)


def strut_radius(subject: Model) -> float:
    """Drawn radius of struts [m]."""
    return 0.007 * thickness(subject)


def shapes(subject: Model, tree: Tree) -> tuple[Shape, ...]:
    """All shapes but the struts, each on a body of the tree, in its link frame; '' is the world."""
    s = thickness(subject)
    parts = [*_platform(subject, tree, s), *_ends_of_struts(tree, s), *_tool(tree, s)]
    for n, limb in enumerate(subject.robot.limb_geometry, 1):
        parts += _limb(subject, limb, n, s)
    return (*parts, *_base(subject, s), *_telescope(subject, s))


def _limb(subject: Model, limb: LimbGeometry, n: int, s: float) -> Iterator[Shape]:
    """A motor in the world along the limb's y, and the upper arm along its x; or a rail as long as
    the drive's range, and its carriage."""
    if limb.drive == "rotary":
        y, elbow = 0.07 * s * limb.R_WL[:, 1], limb.upper_arm * X
        yield Rod("", f"motor{n}", "motor", limb.base - y, limb.base + y, 0.045 * s, round=False)
        yield Rod(f"U{n}", f"arm{n}", "arm", ZERO, elbow, 0.02 * s)
    else:
        yield Rod("", f"rail{n}", "base", *_rail(subject, limb, n, s), 0.018 * s)
        R, half = _along_rail(limb), s * np.array([0.025, 0.05, 0.05])
        yield BoxShape(f"C{n}", f"carriage{n}", "arm", ZERO, R, half)


def _along_rail(limb: LimbGeometry) -> Float[np.ndarray, "3 3"]:
    """Axes in the limb's frame with z along the rail."""
    return Rotation.align_vectors([limb.rail], [Z])[0].as_matrix()


def _rail(subject: Model, limb: LimbGeometry, n: int, s: float) -> tuple[Vector, Vector]:
    """Both ends of a rail, which lies behind the joints of its carriage."""
    q = subject.dynamics.kinematics.inverse(subject.home)[n - 1]
    ends = subject.robot.limits_of(f"drive{n}").range
    low, high = ends or (q - 0.5 * limb.strut, q + 0.5 * limb.strut)
    behind = -0.035 * s * _along_rail(limb)[:, 0] * (1 if limb.outwards else -1)
    place, along = limb.base + limb.R_WL @ behind, limb.R_WL @ limb.rail
    return place + low * along, place + high * along


def _base(subject: Model, s: float) -> Iterator[Shape]:
    """A plate above the motors, or one at both ends of the rails."""
    limbs = subject.robot.limb_geometry
    if limbs[0].drive == "rotary":
        bases = np.array([limb.base for limb in limbs])
        middle, up = bases.mean(axis=0), 0.06 * s * Z
        radius = float(np.linalg.norm(bases - middle, axis=1).max()) + 0.06 * s
        yield Rod("", "base", "base", middle + up, middle + up + 0.02 * s * Z, radius, round=False)
        return
    rails = [_rail(subject, limb, n, s) for n, limb in enumerate(limbs, 1)]
    for end in (0, 1):
        points = sorted((rail[end] for rail in rails), key=lambda r: np.arctan2(r[1], r[0]))
        for k, point in enumerate(points):
            yield Rod("", f"frame{end + 1}_{k + 1}", "base", points[k - 1], point, 0.012 * s)


def _ends_of_struts(tree: Tree, s: float) -> Iterator[Shape]:
    """Balls at the ends of all struts, and the bars between those of a pair."""
    for strut in tree.struts:
        for point in (strut.first, strut.second):
            yield Ball(point.body, point.name, "steel", point.position, 0.013 * s)
    for a, b in zip(tree.struts, tree.struts[1:], strict=False):
        for p, q in ((a.first, b.first), (a.second, b.second)) if a.body == b.body else ():
            name = f"{p.name.removesuffix('_elbow').removesuffix('_seat')}_{p.body}_bar"
            yield Rod(p.body, name, "steel", p.position, q.position, 0.008 * s)


def _platform(subject: Model, tree: Tree, s: float) -> Iterator[Shape]:
    """A spoke to the seats of each limb, and a plate in the middle, or both parts of a turning
    platform with their joint."""
    platform, colour = subject.robot.platform, "platform"
    for cut in tree.cuts:
        seat = cut.second
        if seat.name.endswith("_seat") and np.linalg.norm(seat.position) > 1e-3:
            yield Rod(seat.body, f"{cut.name}_spoke", colour, ZERO, seat.position, 0.011 * s)
    thick, lift = 0.012 * s * Z, 0.014 * s * Z
    if isinstance(platform, RigidPlatform):
        seats = [cut.second.position for cut in tree.cuts if cut.second.body == "P"]
        radius = max(0.6 * max(float(np.linalg.norm(r[:2])) for r in seats), 0.02 * s)
        yield Rod("P", "platform", colour, -thick, thick, radius, round=False)
        return
    for part in (f"{platform.bodies[0]}{k}" for k in (1, 2)):
        yield Rod(part, f"{part}_hub", colour, -thick, thick, 0.03 * s, round=False)
    if isinstance(platform, I4Platform):
        e = 0.12 * s * platform.direction
        yield Rod("HP1", "rack", "steel", lift - e, lift + e, 0.008 * s)
    else:
        half = platform.arm * X
        yield Rod(platform.bodies[1], "middle", "steel", lift - half, lift + half, 0.012 * s)


def _tool(tree: Tree, s: float) -> Iterator[Shape]:
    """A flange that points down, with a mark of its angle."""
    body = tree.tool_body
    yield Rod(body, "flange", "steel", ZERO, -0.045 * s * Z, 0.024 * s, round=False)
    yield Rod(body, "tip", "tool", -0.045 * s * Z, -0.075 * s * Z, 0.011 * s, round=False)
    if body == "EE":
        half = s * np.array([0.016, 0.004, 0.004])
        yield BoxShape(body, "mark", "tool", s * np.array([0.024, 0.0, -0.04]), I, half)


def _telescope(subject: Model, s: float) -> Iterator[Shape]:
    """Both halves of the telescopic bar, as long as they may be."""
    if (bar := subject.robot.telescope) is not None:
        way = np.subtract(bar.base_joint, subject.home[:3] + bar.platform_joint)
        length = 0.97 * (bar.stroke[0] if bar.stroke else 0.6 * float(np.linalg.norm(way)))
        yield Rod("TU", "bar_upper", "steel", ZERO, -length * Z, 0.014 * s)
        yield Rod("TL", "bar_lower", "strut", ZERO, length * Z, 0.009 * s)
