"""A robot as a spanning tree of bodies with its loops cut, for programs that only know trees.

Every limb is cut where its struts hold the platform, the telescope where it meets the platform.
Struts of a limb move alike, so they are one body with the inertia of all of them, and the
platform's parts translate because they are put on sliding joints, not because parallelograms hold
them. So the tree has exactly as many closing conditions as it needs, none of them redundant:

    cuts        two points of different bodies coincide (three conditions each)
    couplings   one joint follows another by a constant ratio (one condition each)

Joints with friction, springs and motors are joints of the tree and have the description's names.
Body frames are the link frames of docs/conventions.md.
"""

from dataclasses import dataclass

import numpy as np

from deltaid.exports.tree_parts import (
    Coupling,
    LoopCut,
    Tree,
    TreeBody,
    TreeJoint,
    TreePoint,
    TreeStrut,
)
from deltaid.mechanism.mechanism import LimbBodies
from deltaid.mechanism.tree_joints import tree_coordinates
from deltaid.model.model import Model
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import H4Platform, I4Platform, Par4Platform, RigidPlatform, Telescope

_X, _Y, _Z = np.eye(3)
# What two struts are drawn apart whose distance is not described, as a share of their length.
_DRAWN_SPACING = 0.08


@dataclass(frozen=True)
class _Part:
    """Some bodies of the tree with what belongs to them."""

    bodies: tuple[TreeBody, ...]
    cuts: tuple[LoopCut, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    struts: tuple[TreeStrut, ...] = ()


def spanning_tree(subject: Model) -> Tree:
    """The tree of a robot that is composed of limbs and a platform.

    Raises:
        DeltaidError: the mechanism is the user's own, so its joints are not known.
    """
    robot, mechanism = subject.robot, subject.dynamics.kinematics.mechanism
    coordinates = tree_coordinates(robot, mechanism)
    parts = [_platform(subject)]
    for i, (geometry, limb) in enumerate(zip(robot.limb_geometry, mechanism.limbs, strict=True)):
        parts.append(_limb(subject, i, geometry, limb))
    if robot.telescope is not None:
        parts.append(_telescope(subject, robot.telescope))
    return Tree(
        bodies=tuple(body for part in parts for body in part.bodies),
        cuts=tuple(cut for part in parts for cut in part.cuts),
        couplings=tuple(coupling for part in parts for coupling in part.couplings),
        struts=tuple(strut for part in parts for strut in part.struts),
        coordinates=coordinates,
        z=mechanism.z,
    )


def _limb(subject: Model, i: int, geometry: LimbGeometry, limb: LimbBodies) -> _Part:
    """Driven body and strut, R_LS = R_y(α) R_z(β)."""
    n, platform = i + 1, subject.robot.platform
    rotary, strut = geometry.drive == "rotary", geometry.strut
    driven, rod = f"{limb.driven.name[0]}{n}", f"S{n}"
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
        ),
        TreeBody(
            rod,
            driven,
            np.eye(3),
            elbow,
            (TreeJoint(f"limb{n}_swing", False, _Y), TreeJoint(f"limb{n}_tilt", False, _Z)),
            limb.strut.count * subject.body(limb.strut.name),
        ),
    )
    held = _held_part(platform, i)
    cut = LoopCut(
        f"limb{n}",
        TreePoint(f"limb{n}_strut", rod, strut * _X),
        TreePoint(f"limb{n}_seat", held, geometry.attachment),
    )
    struts = tuple(
        TreeStrut(
            f"strut{n}{letter}",
            rod,
            TreePoint(f"strut{n}{letter}_elbow", driven, elbow + side * _Y),
            TreePoint(
                f"strut{n}{letter}_seat", held, geometry.attachment + side * geometry.R_WL[:, 1]
            ),
        )
        for letter, side in _sides(geometry)
    )
    return _Part(bodies, (cut,), struts=struts)


def _sides(geometry: LimbGeometry) -> tuple[tuple[str, float], ...]:
    """Letters of a limb's struts, and how far along y they stand from the middle [m]."""
    if geometry.struts == 1:
        return (("", 0.0),)
    spacing = _DRAWN_SPACING * geometry.strut if geometry.spacing is None else geometry.spacing
    return (("a", 0.5 * spacing), ("b", -0.5 * spacing))


def _held_part(platform: RigidPlatform | H4Platform | Par4Platform | I4Platform, limb: int) -> str:
    if isinstance(platform, RigidPlatform):
        return "P"
    return f"{platform.bodies[0]}{1 if platform.on_first(limb) else 2}"


def _platform(subject: Model) -> _Part:
    platform = subject.robot.platform
    if isinstance(platform, RigidPlatform):
        body = TreeBody("P", "", np.eye(3), np.zeros(3), _slides("platform"), subject.body("P"))
        return _Part((body,))
    if isinstance(platform, I4Platform):
        return _i4(subject, platform)
    return _hinged(subject, platform)


def _hinged(subject: Model, platform: H4Platform | Par4Platform) -> _Part:
    """A middle (bar, or both rods) that turns by θ, parts on it that turn back, and the tool."""
    par4 = isinstance(platform, Par4Platform)
    half = 0.5 * platform.length if par4 else platform.half_length
    part, middle = platform.bodies[:2]
    turn = TreeJoint("platform", False, _Z)
    inertia = (2 if par4 else 1) * subject.body(middle)
    slides = (*_slides("middle"), turn)
    bodies = [TreeBody(middle, "", np.eye(3), np.zeros(3), slides, inertia)]
    couplings = []
    for k, side in ((1, half), (2, -half)):
        name, back = f"{part}{k}", TreeJoint(f"part{k}_turn", False, _Z)
        bodies.append(TreeBody(name, middle, np.eye(3), side * _X, (back,), subject.body(part)))
        couplings.append(Coupling(back.name, "platform", -1.0))
    carrier, slides = _tool_carrier(platform), ()
    if not carrier:  # follows the middle without turning with it
        slides = _slides("tool")
        couplings += [Coupling(f"tool_{axis}", f"middle_{axis}", 1.0) for axis in "xyz"]
    joints, place = (*slides, TreeJoint("tool", False, _Z)), np.array(platform.tool)
    bodies.append(TreeBody("EE", carrier, np.eye(3), place, joints, subject.body("EE")))
    couplings.append(Coupling("tool", "platform", platform.ratio))
    return _Part(tuple(bodies), couplings=tuple(couplings))


def _i4(subject: Model, platform: I4Platform) -> _Part:
    """The first half platform slides in the world, the second and the tool on the first."""
    e, place = platform.direction, np.array(platform.tool)
    half, along = subject.body("HP"), TreeJoint("platform", True, -e)
    I, zero = np.eye(3), np.zeros(3)
    carrier, rack = _tool_carrier(platform), TreeJoint("tool_rack", True, -e)
    turn = TreeJoint("tool", False, _Z)
    joints = (turn,) if carrier else (rack, turn)
    bodies = (
        TreeBody("HP1", "", I, zero, _slides("part1"), half),
        TreeBody("HP2", "HP1", I, zero, (along,), half),
        TreeBody("EE", carrier or "HP1", I, place, joints, subject.body("EE")),
    )
    couplings = [Coupling("tool", "platform", platform.ratio)]
    if not carrier:  # half-way between the half platforms
        couplings.append(Coupling("tool_rack", "platform", 0.5))
    return _Part(bodies, couplings=tuple(couplings))


def _tool_carrier(platform: H4Platform | Par4Platform | I4Platform) -> str:
    """Name of the part that carries the tool; empty for the middle."""
    number = {"middle": "", "first": "1", "second": "2"}[platform.tool_on]
    return number and f"{platform.bodies[0]}{number}"


def _telescope(subject: Model, bar: Telescope) -> _Part:
    """Both halves of the bar, R_WT = R_z(ψ) R_x(a) R_y(b), and the end effector on the platform."""
    upper = tuple(
        TreeJoint(name, False, axis)
        for name, axis in (("drive4", _Z), ("bar_x", _X), ("bar_y", _Y))
    )
    I, top, zero = np.eye(3), np.array(bar.base_joint), np.zeros(3)
    bodies = (
        TreeBody("TU", "", I, top, upper, subject.body("TU")),
        TreeBody("TL", "TU", I, zero, (TreeJoint("slide", True, -_Z),), subject.body("TL")),
        TreeBody("EE", "P", I, zero, (TreeJoint("tool", False, _Z),), subject.body("EE")),
    )
    seat = TreePoint("bar_seat", "P", np.array(bar.platform_joint))
    cut = LoopCut("bar", TreePoint("bar_end", "TL", zero), seat)
    return _Part(bodies, (cut,), (Coupling("tool", "drive4", 1.0),))


def _slides(name: str) -> tuple[TreeJoint, ...]:
    return tuple(
        TreeJoint(f"{name}_{k}", True, axis) for k, axis in zip("xyz", np.eye(3), strict=True)
    )
