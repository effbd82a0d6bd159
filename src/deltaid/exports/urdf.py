"""A model as URDF, which only knows trees, with a JSON file beside it for what closes the loops.

Links are the tree's bodies in their link frames, on a base that stands in `world`. A body on
several joints has links between them, and every point where a loop was cut is a fixed frame. The
file beside it names the pairs of frames that coincide, the joints that follow others, the home
pose, and what URDF has no words for: inertia of motors and gears, springs.

Links between joints have no mass in the model. Gazebo drops a link below 1e-6 kg with all that
hangs on it, so they have a placeholder that is as small as it may be; the file beside names them.
Fixed frames have none: they are part of the link that they stand on.

Drives have `ros2_control` for ROS 2, `transmission` for Drake and ROS 1. All their quantities are
those of the joint, so every transmission has the ratio 1, and the inertia of motor and gear is that
seen from the joint.
"""

import json
from collections.abc import Iterable, Iterator
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.errors import Doubt
from deltaid.exports.looks import COLOURS, Ball, Rod, Shape, shapes, strut_radius
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import Export, element, numbers, xml_text
from deltaid.exports.tree import ZERO, I, Tree, TreeBody, TreeJoint, TreeStrut, X, spanning_tree
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.sensors.weighings import roll_pitch_yaw

_WORLD, _BASE = "world", "base"
# Mass [kg] and moments about the centre of mass [kg m²] of links that have none in the model.
PLACEHOLDER = (2e-6, 1e-10)
# URDF demands limits of sliding joints, which passive ones do not have: far beyond any robot.
_FAR, _STRONG, _FAST = 1e2, 1e6, 1e3
# Stands in for the driver of the robot's own controller: commands become states.
_HARDWARE = "mock_components/GenericSystem"
_SIMPLE = "transmission_interface/SimpleTransmission"


def urdf(subject: Model) -> Export:
    """A model as URDF, XML, with its loops beside it, JSON; warnings say what stands only there.

    Raises:
        DeltaidError: the mechanism is the user's own, or its friction has terms that URDF lacks.
    """
    tree, forces = spanning_tree(subject), joint_forces(subject, "URDF")
    drawn = shapes(subject, tree)
    # Struts that have a twin; a single one is drawn on the body that it is.
    bodies = [strut.body for strut in tree.struts]
    alone, pairs = (
        [strut for strut in tree.struts if bodies.count(strut.body) == count] for count in (1, 2)
    )
    parts: list[ET.Element] = [
        *(element("material", element("color", rgba=x), name=name) for name, x in COLOURS.items()),
        element("link", name=_WORLD),
        _link(_BASE, _placeholder(), drawn, on=""),
        _fixed(_BASE, _WORLD, ZERO),
    ]
    lengths = {cut.first.body: cut.first.position for cut in tree.cuts}
    drawn += tuple(
        Rod(s.body, s.name, "strut", ZERO, lengths[s.body], strut_radius(subject)) for s in alone
    )
    for body in tree.bodies:
        parts += _link_and_joints(subject.robot, tree, body, drawn, forces)
    for strut in pairs:
        parts += _drawn_strut(subject, strut)
    for point in (point for cut in tree.cuts for point in (cut.first, cut.second)):
        parts += [
            element("link", name=point.name),
            _fixed(point.name, point.body, point.position),
        ]
    root = element(
        "robot",
        *parts,
        element("link", name="tool0"),
        _fixed("tool0", tree.tool_body, ZERO),
        *_control(subject, tree.joint_coordinates(subject.home), forces),
        name=subject.name,
        # Drake reads the inertia of motors and gears from its own names, which others pass over.
        **{"xmlns:drake": "http://drake.mit.edu"},
    )
    empty = numbers(PLACEHOLDER[:1])
    masses = {link.get("name", ""): link.find("inertial/mass") for link in root.iter("link")}
    placeholders = [n for n, m in masses.items() if m is not None and m.get("value") == empty]
    text = xml_text(root, '<?xml version="1.0"?>\n', subject.provenance)
    loops = _loops(subject, tree, forces, [f"{strut.name}_tilt" for strut in pairs], placeholders)
    return Export({".urdf": text, ".loops.json": loops}, _warnings(forces))


def _link_and_joints(
    robot: RobotDescription,
    tree: Tree,
    body: TreeBody,
    drawn: Iterable[Shape],
    forces: dict[str, JointForces],
) -> Iterator[ET.Element]:
    """Links without mass of their own between the joints, the body on the last one."""
    parent, R, r = body.parent or _BASE, body.R, body.r
    following = {c.joint: c for c in tree.couplings}
    for joint in body.joints:
        if joint is body.joints[-1]:
            name, inertia = body.name, RigidBody(body.p)
            inertial = _inertial(inertia.com, inertia.mass, inertia.about_com)
            yield _link(name, inertial, drawn, on=name)
        else:
            name = f"{body.name}_{joint.name}"
            yield _link(name, _placeholder())
        moved = element("joint", name=joint.name, type=_kind(robot, joint))
        moved.extend([*_place(parent, name, R, r), element("axis", xyz=joint.axis)])
        moved.extend(_limit(robot, joint))
        if joint.name in following:
            moved.append(_mimic(following[joint.name].follows, following[joint.name].ratio))
        own = forces.get(joint.name)
        if own and (own.viscous or own.coulomb):
            moved.append(element("dynamics", damping=own.viscous, friction=own.coulomb))
        yield moved
        parent, R, r = name, I, ZERO


def _drawn_strut(subject: Model, strut: TreeStrut) -> Iterator[ET.Element]:
    """One of a pair, to look at: beside the middle along y, tilting as the middle does.

    The pair's inertia is that of the body in their middle, which moves as they do.
    """
    limb = int(strut.body[1:])
    geometry = subject.robot.limb_geometry[limb - 1]
    rod = Rod(strut.name, strut.name, "strut", ZERO, geometry.strut * X, strut_radius(subject))
    yield _link(strut.name, _placeholder(), [rod], on=strut.name)
    side = strut.first.position - geometry.upper_arm * X
    yield element(
        "joint",
        *_place(f"{strut.body}_limb{limb}_swing", strut.name, I, side),
        element("axis", xyz="0.0 0.0 1.0"),
        _mimic(f"limb{limb}_tilt", 1.0),
        name=f"{strut.name}_tilt",
        type="continuous",
    )


def _link(name: str, inertial: ET.Element, drawn: Iterable[Shape] = (), on: str = "") -> ET.Element:
    """A link with the shapes that are on one body."""
    return element("link", inertial, *map(_visual, (s for s in drawn if s.body == on)), name=name)


def _mimic(follows: str, ratio: float) -> ET.Element:
    return element("mimic", joint=follows, multiplier=ratio, offset="0.0")


def _fixed(link: str, on: str, position: Float[np.ndarray, " 3"]) -> ET.Element:
    return element("joint", *_place(on, link, I, position), name=f"{link}_fixed", type="fixed")


def _placeholder() -> ET.Element:
    mass, moment = PLACEHOLDER
    return _inertial(ZERO, mass, moment * I)


def _inertial(com: Float[np.ndarray, " 3"], mass: float, T: Float[np.ndarray, "3 3"]) -> ET.Element:
    """Mass, and inertia about the centre of mass in the link's axes."""
    entries = {
        f"i{a}{b}": T[i, j] for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j
    }
    return element(
        "inertial",
        element("origin", xyz=com, rpy=ZERO),
        element("mass", value=mass),
        element("inertia", **entries),
    )


def _place(
    parent: str, child: str, R: Float[np.ndarray, "3 3"], r: Float[np.ndarray, " 3"]
) -> tuple[ET.Element, ...]:
    """A joint's frame in its parent link; URDF's roll, pitch and yaw are about fixed axes."""
    return (
        element("origin", xyz=r, rpy=roll_pitch_yaw(R)),
        element("parent", link=parent),
        element("child", link=child),
    )


def _kind(robot: RobotDescription, joint: TreeJoint) -> str:
    if joint.slides:
        return "prismatic"
    return "revolute" if robot.limits_of(joint.name).range else "continuous"


def _limit(robot: RobotDescription, joint: TreeJoint) -> Iterator[ET.Element]:
    """What the description says of drives and of a bar's stroke; URDF demands it of slides."""
    if joint.name not in robot.drives and not joint.slides:
        return
    limits = robot.limits_of(joint.name)
    low, high = limits.range or (-_FAR, _FAR)
    if joint.name == "slide" and robot.telescope is not None and robot.telescope.stroke:
        low, high = robot.telescope.stroke
    bounded = _kind(robot, joint) != "continuous"
    yield element(
        "limit",
        effort=limits.effort or _STRONG,
        velocity=limits.top_speed or _FAST,
        lower=low if bounded else None,
        upper=high if bounded else None,
    )


def _visual(shape: Shape) -> ET.Element:
    """One shape on a link; cylinders of URDF stand along z about their middle, with flat ends."""
    match shape:
        case Rod():
            along = shape.end - shape.start
            length = float(np.linalg.norm(along))
            turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
            centre, R = 0.5 * (shape.start + shape.end), turn.as_matrix()
            form = element("cylinder", radius=shape.radius, length=length)
        case Ball():
            centre, R, form = shape.centre, I, element("sphere", radius=shape.radius)
        case _:
            centre, R, form = shape.centre, shape.R, element("box", size=2 * shape.half)
    return element(
        "visual",
        element("origin", xyz=centre, rpy=roll_pitch_yaw(R)),
        element("geometry", form),
        element("material", name=shape.colour),
        name=shape.name,
    )


def _control(
    subject: Model, home: dict[str, float], forces: dict[str, JointForces]
) -> Iterator[ET.Element]:
    """Interfaces and transmissions of all drives."""
    drives = subject.robot.drives
    yield element(
        "ros2_control",
        element("hardware", element("plugin", text=_HARDWARE)),
        *(_interfaces(subject, drive, home[drive]) for drive in drives),
        *(
            element(
                "transmission",
                element("plugin", text=_SIMPLE),
                element("actuator", name=f"{drive}_motor", role="actuator1"),
                element(
                    "joint",
                    element("mechanical_reduction", text="1.0"),
                    name=drive,
                    role="joint1",
                ),
                name=f"{drive}_transmission",
            )
            for drive in drives
        ),
        name=subject.name,
        type="system",
    )
    for drive in drives:
        interface = element("hardwareInterface", text="hardware_interface/EffortJointInterface")
        motor = element("actuator", element("mechanicalReduction", text="1"), name=f"{drive}_motor")
        if armature := forces.get(drive, JointForces()).armature:
            motor.append(element("drake:rotor_inertia", value=armature))
        yield element(
            "transmission",
            element("type", text=_SIMPLE),
            element("joint", interface, name=drive),
            motor,
            name=f"{drive}_simple",
        )


def _interfaces(subject: Model, drive: str, home: float) -> ET.Element:
    """What may be commanded within which limits, and what is told; it starts in the home pose."""
    limits = subject.robot.limits_of(drive)
    speed, effort = limits.top_speed, limits.effort
    bounds = {
        "position": limits.range,
        "velocity": (-speed, speed) if speed else None,
        "effort": (-effort, effort) if effort else None,
    }
    interfaces = [
        element(
            "command_interface",
            *(
                element("param", name=key, text=numbers([bound]))
                for key, bound in zip(("min", "max"), within or (), strict=False)
            ),
            name=name,
        )
        for name, within in bounds.items()
    ]
    interfaces += [element("state_interface", name=name) for name in bounds]
    interfaces[len(bounds)].append(element("param", name="initial_value", text=numbers([home])))
    return element("joint", *interfaces, name=drive)


def _loops(
    subject: Model,
    tree: Tree,
    forces: dict[str, JointForces],
    tilts: list[str],
    placeholders: list[str],
) -> str:
    content = {
        "robot": subject.name,
        "provenance": subject.provenance,
        "gravity": list(subject.robot.gravity),
        "drives": list(subject.robot.drives),
        "coincident_frames": [
            {"name": cut.name, "frames": [cut.first.name, cut.second.name]} for cut in tree.cuts
        ],
        "following_joints": [
            {"joint": c.joint, "follows": c.follows, "ratio": c.ratio} for c in tree.couplings
        ],
        "drawn_joints": tilts,
        "placeholder_links": placeholders,
        "home": tree.joint_coordinates(subject.home),
        "armature": {joint: f.armature for joint, f in forces.items() if f.armature},
        "springs": {
            joint: {"stiffness": f.stiffness, "rest": f.rest}
            for joint, f in forces.items()
            if f.stiffness
        },
    }
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _warnings(forces: dict[str, JointForces]) -> tuple[str, ...]:
    """What a program that reads the URDF alone will miss, beside the loops."""
    return tuple(
        Doubt(
            f"{what} of {', '.join(joints)} are not in the URDF but in the file of the loops",
            cause="URDF has no words for them",
            cure="let the program that reads the URDF read that file as well",
        )
        for what, joints in {
            "inertia of motors and gears": [j for j, f in forces.items() if f.armature],
            "springs": [j for j, f in forces.items() if f.stiffness],
        }.items()
        if joints
    )
