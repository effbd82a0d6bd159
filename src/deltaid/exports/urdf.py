"""A model as URDF, which only knows trees, with a JSON file beside it for what closes the loops.

Links are the tree's bodies in their link frames, on a base that stands in `world`. A body on
several joints has links between them, and every point where a loop was cut is a fixed frame. The
file beside it names the pairs of frames that coincide, the joints that follow others, the home
pose, and what URDF has no words for: inertia of motors and gears, springs.

Links between joints have no mass in the model. Gazebo drops a link below 1e-6 kg with all that
hangs on it, so they have a placeholder that is as small as it may be; the file beside names them.
Fixed frames have none: they are part of the link that they stand on.
"""

import json
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt
from deltaid.exports.looks import Rod, Shape, shapes, strut_radius, tool_body
from deltaid.exports.spanning_tree import spanning_tree
from deltaid.exports.text import numbers, xml_comment
from deltaid.exports.tree import JointForces, Tree, TreeBody, TreeJoint, TreeStrut, joint_forces
from deltaid.exports.urdf_parts import colours, control, visual
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.sensors.weighings import roll_pitch_yaw

_WORLD, _BASE = "world", "base"
# Mass [kg] and moments about the centre of mass [kg m²] of links that have none in the model.
PLACEHOLDER = (2e-6, 1e-10)
# URDF demands limits of sliding joints, which passive ones do not have: far beyond any robot.
_FAR, _STRONG, _FAST = 1e2, 1e6, 1e3


@dataclass(frozen=True)
class UrdfExport:
    """A URDF file and what belongs to it.

    Attributes:
        urdf: XML text.
        loops: JSON text.
        warnings: what stands only in the second one.
    """

    urdf: str
    loops: str
    warnings: tuple[str, ...]


def urdf(subject: Model) -> UrdfExport:
    """A model as URDF with its loops beside it.

    Raises:
        DeltaidError: the mechanism is the user's own, or its friction has terms that URDF lacks.
    """
    tree, forces = spanning_tree(subject), joint_forces(subject, "URDF")
    drawn = shapes(subject, tree)
    # Drake reads the inertia of motors and gears from names of its own, which others pass over.
    root = ET.Element("robot", {"name": subject.name, "xmlns:drake": "http://drake.mit.edu"})
    root.append(ET.Comment(xml_comment(subject.provenance)))
    colours(root)
    ET.SubElement(root, "link", name=_WORLD)
    base = ET.SubElement(root, "link", name=_BASE)
    _placeholder(base)
    for shape in drawn:
        if not shape.body:
            visual(base, shape)
    _fixed(root, _BASE, _WORLD, np.zeros(3))
    for body in tree.bodies:
        _link_and_joints(root, subject, tree, body, drawn, forces)
    for strut in _pairs(tree):
        _drawn_strut(root, subject, strut)
    for point in (point for cut in tree.cuts for point in (cut.first, cut.second)):
        ET.SubElement(root, "link", name=point.name)
        _fixed(root, point.name, point.body, point.position)
    ET.SubElement(root, "link", name="tool0")
    _fixed(root, "tool0", tool_body(tree), np.zeros(3))
    control(root, subject, tree.joint_coordinates(subject.home), forces)
    ET.indent(root)
    text = '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    return UrdfExport(text, _loops(subject, tree, forces, _placeholders(root)), _warnings(forces))


def _link_and_joints(
    root: ET.Element,
    subject: Model,
    tree: Tree,
    body: TreeBody,
    drawn: tuple[Shape, ...],
    forces: dict[str, JointForces],
) -> None:
    """Links without mass of their own between the joints, the body on the last one."""
    parent, R, r = body.parent or _BASE, body.R, body.r
    following = {c.joint: c for c in tree.couplings}
    for k, joint in enumerate(body.joints):
        last = k == len(body.joints) - 1
        name = body.name if last else f"{body.name}_{joint.name}"
        link = ET.SubElement(root, "link", name=name)
        if last:
            _inertial(link, body)
            for shape in (*drawn, *_single(subject, tree, body)):
                if shape.body == body.name:
                    visual(link, shape)
        else:
            _placeholder(link)
        element = ET.SubElement(root, "joint", name=joint.name, type=_kind(subject.robot, joint))
        _place(element, parent, name, R, r)
        ET.SubElement(element, "axis", xyz=numbers(joint.axis))
        _limit(element, subject.robot, joint)
        if joint.name in following:
            _mimic(element, following[joint.name].follows, following[joint.name].ratio)
        own = forces.get(joint.name)
        if own and (own.viscous or own.coulomb):
            values = {"damping": numbers([own.viscous]), "friction": numbers([own.coulomb])}
            ET.SubElement(element, "dynamics", values)
        parent, R, r = name, np.eye(3), np.zeros(3)


def _pairs(tree: Tree) -> list[TreeStrut]:
    """Struts that have a twin; a single one is drawn on the body that it is."""
    bodies = [strut.body for strut in tree.struts]
    return [strut for strut in tree.struts if bodies.count(strut.body) == 2]


def _single(subject: Model, tree: Tree, body: TreeBody) -> list[Shape]:
    paired = {strut.body for strut in _pairs(tree)}
    lengths = {cut.first.body: cut.first.position for cut in tree.cuts}
    return [
        Rod(body.name, strut.name, "strut", np.zeros(3), lengths[body.name], strut_radius(subject))
        for strut in tree.struts
        if strut.body == body.name and body.name not in paired
    ]


def _drawn_strut(root: ET.Element, subject: Model, strut: TreeStrut) -> None:
    """One of a pair, to look at: beside the middle along y, tilting as the middle does.

    The pair's inertia is that of the body in their middle, which moves as they do.
    """
    limb = int(strut.body[1:])
    geometry = subject.robot.limb_geometry[limb - 1]
    link = ET.SubElement(root, "link", name=strut.name)
    _placeholder(link)
    line = geometry.strut * np.eye(3)[0]
    visual(link, Rod(strut.name, strut.name, "strut", np.zeros(3), line, strut_radius(subject)))
    joint = ET.SubElement(root, "joint", name=f"{strut.name}_tilt", type="continuous")
    side = strut.first.position - geometry.upper_arm * np.eye(3)[0]
    _place(joint, f"{strut.body}_limb{limb}_swing", strut.name, np.eye(3), side)
    ET.SubElement(joint, "axis", xyz="0.0 0.0 1.0")
    _mimic(joint, f"limb{limb}_tilt", 1.0)


def _mimic(element: ET.Element, follows: str, ratio: float) -> None:
    values = {"multiplier": numbers([ratio]), "offset": "0.0"}
    ET.SubElement(element, "mimic", {"joint": follows} | values)


def _fixed(root: ET.Element, link: str, on: str, position: Float[np.ndarray, " 3"]) -> None:
    fixed = ET.SubElement(root, "joint", name=f"{link}_fixed", type="fixed")
    _place(fixed, on, link, np.eye(3), position)


def _placeholder(link: ET.Element) -> None:
    mass, moment = PLACEHOLDER
    _mass_and_moments(link, np.zeros(3), mass, moment * np.eye(3))


def _placeholders(root: ET.Element) -> list[str]:
    """Names of links whose inertia is a placeholder."""
    mass = numbers(PLACEHOLDER[:1])
    found = {link.get("name", ""): link.find("inertial/mass") for link in root.iter("link")}
    return [name for name, of in found.items() if of is not None and of.get("value") == mass]


def _inertial(link: ET.Element, body: TreeBody) -> None:
    """Mass, and inertia about the centre of mass in the link's axes."""
    inertia = RigidBody(body.p)
    _mass_and_moments(link, inertia.com, inertia.mass, inertia.about_com)


def _mass_and_moments(
    link: ET.Element, com: Float[np.ndarray, " 3"], mass: float, T: Float[np.ndarray, "3 3"]
) -> None:
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=numbers(com), rpy=numbers(np.zeros(3)))
    ET.SubElement(element, "mass", value=numbers([mass]))
    entries = {
        f"i{a}{b}": (i, j) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j
    }
    ET.SubElement(element, "inertia", {key: numbers([T[place]]) for key, place in entries.items()})


def _place(
    element: ET.Element,
    parent: str,
    child: str,
    R: Float[np.ndarray, "3 3"],
    r: Float[np.ndarray, " 3"],
) -> None:
    """A joint's frame in its parent link; URDF's roll, pitch and yaw are about fixed axes."""
    ET.SubElement(element, "origin", xyz=numbers(r), rpy=numbers(roll_pitch_yaw(R)))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)


def _kind(robot: RobotDescription, joint: TreeJoint) -> str:
    if joint.slides:
        return "prismatic"
    limits = robot.drive_limits.get(joint.name)
    return "revolute" if limits and limits.range else "continuous"


def _limit(element: ET.Element, robot: RobotDescription, joint: TreeJoint) -> None:
    """What the description says of drives and of a bar's stroke; URDF demands it of slides."""
    limits, turns = robot.drive_limits.get(joint.name), not joint.slides
    if joint.name not in robot.drives and turns:
        return
    low, high = (limits and limits.range) or (-_FAR, _FAR)
    if joint.name == "slide" and robot.telescope is not None and robot.telescope.stroke:
        low, high = robot.telescope.stroke
    effort = (limits and limits.effort) or _STRONG
    speed = (limits and limits.top_speed) or _FAST
    values = {"effort": numbers([effort]), "velocity": numbers([speed])}
    if _kind(robot, joint) != "continuous":
        values |= {"lower": numbers([low]), "upper": numbers([high])}
    ET.SubElement(element, "limit", values)


def _loops(
    subject: Model, tree: Tree, forces: dict[str, JointForces], placeholders: list[str]
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
        "drawn_joints": [f"{strut.name}_tilt" for strut in _pairs(tree)],
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
    found = {
        "inertia of motors and gears": [j for j, f in forces.items() if f.armature],
        "springs": [j for j, f in forces.items() if f.stiffness],
    }
    return tuple(
        Doubt(
            f"{what} of {', '.join(joints)} are not in the URDF but in the file of the loops",
            cause="URDF has no words for them",
            cure="let the program that reads the URDF read that file as well",
        )
        for what, joints in found.items()
        if joints
    )
