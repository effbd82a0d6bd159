"""The spanning tree of a robot that is composed of limbs, a platform and perhaps a telescope."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.errors import DeltaidError
from deltaid.export.tree import Coupling, Cut, Line, Point, Tree, TreeBody, TreeJoint
from deltaid.mechanism.mechanism import LimbBodies
from deltaid.model.model import Model
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform, RigidPlatform
from deltaid.robot.telescope import Telescope

_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True)
class _Part:
    """Some bodies of the tree with what belongs to them."""

    bodies: tuple[TreeBody, ...]
    coordinates: dict[str, ca.SX]
    cuts: tuple[Cut, ...] = ()
    couplings: tuple[Coupling, ...] = ()


def spanning_tree(subject: Model) -> Tree:
    """The tree of a robot that is composed of limbs and a platform.

    Raises:
        DeltaidError: the mechanism is the user's own, so its joints are not known.
    """
    robot, mechanism = subject.robot, subject.dynamics.kinematics.mechanism
    if robot.mechanism is not None:
        raise DeltaidError(
            "has a mechanism of its own, of which only poses are known and no joints",
            where=subject.source,
            cure="choose a target without bodies and joints: c, fmu, casadi or npz",
        )
    parts = [_platform(subject)]
    for i, (geometry, limb) in enumerate(zip(robot.limb_geometry, mechanism.limbs, strict=True)):
        q = mechanism.joints[f"drive{i + 1}"]
        parts.append(_limb(subject, i, geometry, limb, q))
    if robot.telescope is not None:
        parts.append(_telescope(subject, robot.telescope))
    return Tree(
        bodies=tuple(body for part in parts for body in part.bodies),
        cuts=tuple(cut for part in parts for cut in part.cuts),
        couplings=tuple(coupling for part in parts for coupling in part.couplings),
        coordinates={name: x for part in parts for name, x in part.coordinates.items()},
        z=mechanism.z,
    )


def _limb(subject: Model, i: int, geometry: LimbGeometry, limb: LimbBodies, q: ca.SX) -> _Part:
    """Driven body and strut. R_LS = R_y(α) R_z(β), so x_S = (cos α cos β, sin β, −sin α cos β)."""
    n, platform = i + 1, subject.robot.platform
    rotary, strut = geometry.drive == "rotary", geometry.strut
    driven, rod, x_S = f"{limb.driven.name[0]}{n}", f"S{n}", limb.strut.rotation.R[:, 0]
    elbow = geometry.upper_arm * _X
    axis = _Y if rotary else geometry.rail
    bodies = (
        TreeBody(
            driven,
            "",
            geometry.R_WL,
            geometry.base,
            (TreeJoint(f"drive{n}", not rotary, axis),),
            subject.body(limb.driven.name),
            ((np.zeros(3), elbow),) if rotary else (),
        ),
        TreeBody(
            rod,
            driven,
            np.eye(3),
            elbow,
            (TreeJoint(f"limb{n}_swing", False, _Y), TreeJoint(f"limb{n}_tilt", False, _Z)),
            limb.strut.count * subject.body(limb.strut.name),
            ((np.zeros(3), strut * _X),),
        ),
    )
    held = _held_part(platform, i)
    cut = Cut(
        f"limb{n}",
        Point(f"limb{n}_strut", rod, strut * _X),
        Point(f"limb{n}_seat", held, geometry.attachment),
    )
    swing = ca.atan2(-x_S[2], x_S[0]) - (q if rotary else 0)
    coordinates = {f"drive{n}": q, f"limb{n}_swing": swing, f"limb{n}_tilt": ca.asin(x_S[1])}
    return _Part(bodies, coordinates, (cut,))


def _held_part(platform: RigidPlatform | H4Platform | Par4Platform | I4Platform, limb: int) -> str:
    """Name of the tree's body that a limb holds."""
    if isinstance(platform, RigidPlatform):
        return "P"
    return f"{platform.bodies[0]}{1 if platform.on_first(limb) else 2}"


def _platform(subject: Model) -> _Part:
    platform, z = subject.robot.platform, subject.dynamics.kinematics.mechanism.z
    if isinstance(platform, RigidPlatform):
        lines = _spokes(subject, "P")
        body = TreeBody(
            "P", "", np.eye(3), np.zeros(3), _slides("platform"), subject.body("P"), lines
        )
        return _Part((body,), _positions("platform", z[:3]))
    joint = z[3] / platform.ratio
    if isinstance(platform, I4Platform):
        return _i4(subject, platform, z, joint)
    return _hinged(subject, platform, z, joint)


def _hinged(subject: Model, platform: H4Platform | Par4Platform, z: ca.SX, theta: ca.SX) -> _Part:
    """A middle (bar, or both rods) that turns by θ, parts on it that turn back, and the tool."""
    par4 = isinstance(platform, Par4Platform)
    half = 0.5 * platform.length if par4 else platform.half_length
    part, middle = platform.bodies[:2]
    turn = TreeJoint("platform", False, _Z)
    inertia = (2 if par4 else 1) * subject.body(middle)
    lines = ((-half * _X, half * _X),)
    slides = (*_slides("middle"), turn)
    bodies = [TreeBody(middle, "", np.eye(3), np.zeros(3), slides, inertia, lines)]
    coordinates = _positions("middle", z[:3]) | {"platform": theta}
    couplings = []
    for k, side in ((1, half), (2, -half)):
        name, back = f"{part}{k}", TreeJoint(f"part{k}_turn", False, _Z)
        spokes = _spokes(subject, name)
        bodies.append(
            TreeBody(name, middle, np.eye(3), side * _X, (back,), subject.body(part), spokes)
        )
        coordinates[back.name] = -theta
        couplings.append(Coupling(back.name, "platform", -1.0))
    carrier, slides = _tool_carrier(platform), ()
    if not carrier:  # follows the middle without turning with it
        slides = _slides("tool")
        coordinates |= _positions("tool", z[:3])
        couplings += [Coupling(f"tool_{axis}", f"middle_{axis}", 1.0) for axis in "xyz"]
    joints, place = (*slides, TreeJoint("tool", False, _Z)), np.array(platform.tool)
    bodies.append(TreeBody("EE", carrier, np.eye(3), place, joints, subject.body("EE")))
    coordinates["tool"] = z[3]
    couplings.append(Coupling("tool", "platform", platform.ratio))
    return _Part(tuple(bodies), coordinates, couplings=tuple(couplings))


def _i4(subject: Model, platform: I4Platform, z: ca.SX, s: ca.SX) -> _Part:
    """The first half platform slides in the world, the second and the tool on the first."""
    angle, place = np.deg2rad(platform.direction_deg), np.array(platform.tool)
    e = np.array([np.cos(angle), np.sin(angle), 0.0])
    half, along = subject.body("HP"), TreeJoint("platform", True, -e)
    I, zero = np.eye(3), np.zeros(3)
    carrier, rack = _tool_carrier(platform), TreeJoint("tool_rack", True, -e)
    turn = TreeJoint("tool", False, _Z)
    joints = (turn,) if carrier else (rack, turn)
    bodies = (
        TreeBody("HP1", "", I, zero, _slides("part1"), half, _spokes(subject, "HP1")),
        TreeBody("HP2", "HP1", I, zero, (along,), half, _spokes(subject, "HP2")),
        TreeBody("EE", carrier or "HP1", I, place, joints, subject.body("EE")),
    )
    first = z[:3] + 0.5 * s * ca.DM(e)
    coordinates = _positions("part1", first) | {"platform": s, "tool": z[3]}
    couplings = [Coupling("tool", "platform", platform.ratio)]
    if not carrier:  # half-way between the half platforms
        coordinates["tool_rack"] = 0.5 * s
        couplings.append(Coupling("tool_rack", "platform", 0.5))
    return _Part(bodies, coordinates, couplings=tuple(couplings))


def _tool_carrier(platform: H4Platform | Par4Platform | I4Platform) -> str:
    """Name of the part that carries the tool; empty for the middle."""
    numbers = {"middle": "", "first": "1", "second": "2"}
    number = numbers[platform.tool_on]
    return number and f"{platform.bodies[0]}{number}"


def _telescope(subject: Model, bar: Telescope) -> _Part:
    """Both halves of the bar, R_WT = R_z(ψ) R_x(a) R_y(b), and the end effector on the platform."""
    mechanism = subject.dynamics.kinematics.mechanism
    r, psi = mechanism.z[:3], mechanism.z[3]
    span = ca.DM(bar.base_joint) - r - ca.DM(bar.platform_joint)
    c, s = ca.cos(psi), ca.sin(psi)
    length = ca.sqrt(ca.sumsqr(span))
    x, y, z = c * span[0] + s * span[1], c * span[1] - s * span[0], span[2]
    upper = tuple(
        TreeJoint(name, False, axis)
        for name, axis in (("drive4", _Z), ("bar_x", _X), ("bar_y", _Y))
    )
    half = 0.5 * abs(subject.home[2]) * _Z
    I, top, zero = np.eye(3), np.array(bar.base_joint), np.zeros(3)
    bodies = (
        TreeBody("TU", "", I, top, upper, subject.body("TU"), ((zero, -half),)),
        TreeBody("TL", "TU", I, zero, (TreeJoint("slide", True, -_Z),), subject.body("TL"),
                 ((zero, half),)),
        TreeBody("EE", "P", I, zero, (TreeJoint("tool", False, _Z),), subject.body("EE")),
    )  # fmt: skip
    coordinates = {
        "drive4": psi,
        "bar_x": ca.atan2(-y, z),
        "bar_y": ca.asin(x / length),
        "slide": length,
        "tool": psi,
    }
    seat = Point("bar_seat", "P", np.array(bar.platform_joint))
    cut = Cut("bar", Point("bar_end", "TL", zero), seat)
    return _Part(bodies, coordinates, (cut,), (Coupling("tool", "drive4", 1.0),))


def _slides(name: str) -> tuple[TreeJoint, ...]:
    """Three sliding joints along the world's axes."""
    return tuple(
        TreeJoint(f"{name}_{k}", True, axis) for k, axis in zip("xyz", np.eye(3), strict=True)
    )


def _positions(name: str, r: ca.SX) -> dict[str, ca.SX]:
    return {f"{name}_{k}": r[i] for i, k in enumerate("xyz")}


def _spokes(subject: Model, part: str) -> tuple[Line, ...]:
    """From a part's point to the strut joints that it has."""
    robot = subject.robot
    return tuple(
        (np.zeros(3), limb.attachment)
        for i, limb in enumerate(robot.limb_geometry)
        if _held_part(robot.platform, i) == part
    )
