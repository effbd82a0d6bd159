"""A robot as a spanning tree of bodies with cut loops, for formats that only represent trees.

Every limb is cut at the platform's end of its struts, the telescope at the platform. Struts of a
limb move equally, so they are one body with the inertia of all of them; the platform's parts
translate on sliding joints, which replace the parallelograms. So the tree has exactly the necessary
closing conditions, none of them redundant:

    cuts        two points of different bodies coincide (three conditions each)
    couplings   one joint follows another by a constant ratio (one condition each)

Joints with friction, springs and motors are joints of the tree and have the description's names.
Body frames are the link frames of docs/conventions.md.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.mechanism.mechanism import LimbBodies
from deltaid.mechanism.platform import HALF_TURN
from deltaid.mechanism.skeleton import drawn_spacing
from deltaid.mechanism.tree_joints import tree_coordinates
from deltaid.model.model import Model
from deltaid.robot.inertia import RigidBody
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform, RigidPlatform, Telescope

Vector = Float[np.ndarray, " 3"]
I, ZERO = np.eye(3), np.zeros(3)
X, Y, Z = I
# Rotations of the two equal parts of a platform, both in the middle's frame.
_HALVES = (I, HALF_TURN)


@dataclass(frozen=True)
class TreeJoint:
    """A joint with one coordinate, whose axis goes through the body's origin.

    Attributes:
        name: 'drive1', 'limb1_swing', …
        slides: whether it slides; otherwise it turns.
        axis: unit vector in the frame after the body's previous joints.
    """

    name: str
    slides: bool
    axis: Vector


@dataclass(frozen=True)
class TreeBody:
    """A body and its joints to its parent.

    Attributes:
        name: unique in the tree.
        parent: name of another body; empty for the world.
        R, r: pose of the link frame in the parent's, with all joints at zero [m].
        joints: in order from the parent.
        p: the ten inertia parameters of all bodies that move together as this one.
    """

    name: str
    parent: str
    R: Float[np.ndarray, "3 3"]
    r: Vector
    joints: tuple[TreeJoint, ...]
    p: Float[np.ndarray, " 10"]


@dataclass(frozen=True)
class TreePoint:
    """A named point of a body, in its link frame [m]."""

    name: str
    body: str
    position: Vector


@dataclass(frozen=True)
class LoopCut:
    """Two points that coincide in the closed robot."""

    name: str
    first: TreePoint
    second: TreePoint


@dataclass(frozen=True)
class TreeStrut:
    """A drawn strut, between two points of other bodies.

    The struts of a limb are one body of the tree, in their middle. They keep their distance along
    the driven body's y and do not tilt about it, so no body of the tree contains both as lines.

    Attributes:
        name: 'strut1a', 'strut1b', …; 'strut1' if a limb has one.
        body: of the tree that it is a part of.
        first, second: ends at the driven body and at the platform.
    """

    name: str
    body: str
    first: TreePoint
    second: TreePoint


@dataclass(frozen=True)
class Coupling:
    """A joint whose coordinate is `ratio` times that of the joint `follows`."""

    joint: str
    follows: str
    ratio: float


@dataclass(frozen=True)
class Tree:
    """The cut robot.

    Attributes:
        bodies: parents before children.
        cuts, couplings: conditions that close the loops.
        struts: to draw.
        tool_body: name of the body that carries the tool.
        home: coordinates of all joints in the closed robot's home pose, by name.
    """

    bodies: tuple[TreeBody, ...]
    cuts: tuple[LoopCut, ...]
    couplings: tuple[Coupling, ...]
    struts: tuple[TreeStrut, ...]
    tool_body: str
    home: dict[str, float]


Part = TreeBody | LoopCut | Coupling | TreeStrut


def spanning_tree(subject: Model) -> Tree:
    """The tree of a robot that consists of limbs and a platform.

    Raises:
        DeltaidError: the mechanism is user-defined, so its joints are unknown.
    """
    robot, mechanism = subject.robot, subject.dynamics.kinematics.mechanism
    coordinates, parts = tree_coordinates(robot, mechanism), list[Part]()  # raises first
    parts += _platform(subject)
    for i, both in enumerate(zip(robot.limb_geometry, mechanism.limbs, strict=True)):
        parts += _limb(subject, i, *both)
    if robot.telescope is not None:
        parts += _telescope(subject, robot.telescope)
    home = ca.Function("x", [mechanism.z], [ca.vertcat(*coordinates.values())])(subject.home)
    return Tree(
        bodies=tuple(part for part in parts if isinstance(part, TreeBody)),
        cuts=tuple(part for part in parts if isinstance(part, LoopCut)),
        couplings=tuple(part for part in parts if isinstance(part, Coupling)),
        struts=tuple(part for part in parts if isinstance(part, TreeStrut)),
        tool_body=robot.load_carrier,
        home=dict(zip(coordinates, np.asarray(home).ravel().tolist(), strict=True)),
    )


def require_physical(model: Model, cure: str) -> None:
    """Refuse bodies that the target's own reader would refuse.

    Raises:
        DeltaidError: a body is not physical; with the given cure.
    """
    for name in model.layout.bodies:
        if reason := RigidBody(model.body(name)).why_not_physical:
            what = f"body {name} cannot be exported: {reason}"
            raise DeltaidError(what, where=model.source, cure=cure)


def _limb(subject: Model, i: int, geometry: LimbGeometry, limb: LimbBodies) -> Iterator[Part]:
    """Driven body and strut, R_LS = R_y(α) R_z(β)."""
    n, platform, rotary = i + 1, subject.robot.platform, geometry.drive == "rotary"
    driven, rod, held, frame = f"{limb.driven.name[0]}{n}", f"S{n}", "P", I
    if not isinstance(platform, RigidPlatform):
        second = not platform.on_first(i)
        held, frame = f"{platform.bodies[0]}{1 + second}", _HALVES[second]
    elbow, seat = geometry.upper_arm * X, frame.T @ geometry.attachment
    drive = TreeJoint(f"drive{n}", not rotary, Y if rotary else geometry.rail)
    p = subject.body(limb.driven.name)
    yield TreeBody(driven, "", geometry.R_WL, geometry.base, (drive,), p)
    joints = (TreeJoint(f"limb{n}_swing", False, Y), TreeJoint(f"limb{n}_tilt", False, Z))
    p = limb.strut.count * subject.body(limb.strut.name)
    yield TreeBody(rod, driven, I, elbow, joints, p)
    end = TreePoint(f"limb{n}_strut", rod, geometry.strut * X)
    yield LoopCut(f"limb{n}", end, TreePoint(f"limb{n}_seat", held, seat))
    spacing = drawn_spacing(subject.robot) if geometry.spacing is None else geometry.spacing
    sides = {"": 0.0} if geometry.struts == 1 else {"a": 0.5 * spacing, "b": -0.5 * spacing}
    for letter, side in sides.items():  # offset from the middle along y
        name = f"strut{n}{letter}"
        yield TreeStrut(
            name,
            rod,
            TreePoint(f"{name}_elbow", driven, elbow + side * Y),
            TreePoint(f"{name}_seat", held, seat + side * frame.T @ geometry.R_WL[:, 1]),
        )


def _platform(subject: Model) -> Iterator[Part]:
    platform = subject.robot.platform
    if isinstance(platform, RigidPlatform):
        yield TreeBody("P", "", I, ZERO, _slides("platform"), subject.body("P"))
    elif isinstance(platform, I4Platform):
        yield from _i4(subject, platform)
    else:
        yield from _hinged(subject, platform)


def _hinged(subject: Model, platform: H4Platform | Par4Platform) -> Iterator[Part]:
    """A middle (bar, or both rods) that turns by θ, parts on it that turn back, and the tool."""
    half, bars = platform.arm, 2 if isinstance(platform, Par4Platform) else 1
    part, middle = platform.bodies[:2]
    slides = (*_slides("middle"), TreeJoint("platform", False, Z))
    yield TreeBody(middle, "", I, ZERO, slides, bars * subject.body(middle))
    for k, frame, side in zip((1, 2), _HALVES, (half, -half), strict=True):
        back = TreeJoint(f"part{k}_turn", False, Z)
        yield TreeBody(f"{part}{k}", middle, frame, side * X, (back,), subject.body(part))
        yield Coupling(back.name, "platform", -1.0)
    if platform.tool_on == "middle":  # it follows the middle without turning with it
        yield from (Coupling(f"tool_{axis}", f"middle_{axis}", 1.0) for axis in "xyz")
    yield from _tool(subject, platform, "", *_slides("tool"))


def _i4(subject: Model, platform: I4Platform) -> Iterator[Part]:
    """The first half platform slides in the world; the second one and the tool slide on the
    first."""
    half, back = subject.body("HP"), -platform.direction
    yield TreeBody("HP1", "", I, ZERO, _slides("part1"), half)
    along = TreeJoint("platform", True, HALF_TURN.T @ back)
    yield TreeBody("HP2", "HP1", HALF_TURN, ZERO, (along,), half)
    yield from _tool(subject, platform, "HP1", TreeJoint("tool_rack", True, back))
    if platform.tool_on == "middle":  # half-way between the half platforms
        yield Coupling("tool_rack", "platform", 0.5)


def _tool(
    subject: Model,
    platform: H4Platform | Par4Platform | I4Platform,
    middle: str,
    *slides: TreeJoint,
) -> Iterator[Part]:
    """The tool on the part that carries it; if that is the middle, by joints that slide on a body
    `middle`."""
    number = {"middle": "", "first": "1", "second": "2"}[platform.tool_on]
    carrier, frame = f"{platform.bodies[0]}{number}" if number else middle, _HALVES[number == "2"]
    joints = (*(() if number else slides), TreeJoint("tool", False, Z))
    yield TreeBody("EE", carrier, frame.T, frame.T @ platform.tool, joints, subject.body("EE"))
    yield Coupling("tool", "platform", platform.ratio)


def _telescope(subject: Model, bar: Telescope) -> Iterator[Part]:
    """Both halves of the bar, R_WT = R_z(ψ) R_x(a) R_y(b), and the end effector on the platform."""
    upper = (("drive4", Z), ("bar_x", X), ("bar_y", Y))
    for name, parent, place, joints in (
        ("TU", "", np.array(bar.base_joint), [TreeJoint(joint, False, k) for joint, k in upper]),
        ("TL", "TU", ZERO, [TreeJoint("slide", True, -Z)]),
        ("EE", "P", ZERO, [TreeJoint("tool", False, Z)]),
    ):
        yield TreeBody(name, parent, I, place, tuple(joints), subject.body(name))
    seat = TreePoint("bar_seat", "P", np.array(bar.platform_joint))
    yield LoopCut("bar", TreePoint("bar_end", "TL", ZERO), seat)
    yield Coupling("tool", "drive4", 1.0)


def _slides(name: str) -> tuple[TreeJoint, ...]:
    return tuple(TreeJoint(f"{name}_{k}", True, axis) for k, axis in zip("xyz", I, strict=True))
