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
from collections.abc import Iterator
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt
from deltaid.exports.looks import Rod, Shape, shapes, strut_radius, tool_body
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import Export, element, numbers, xml_comment
from deltaid.exports.tree import spanning_tree
from deltaid.exports.tree_parts import Tree, TreeBody, TreeJoint, TreeStrut
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


def urdf(subject: Model) -> Export:
    """A model as URDF, XML, with its loops beside it, JSON; warnings say what stands only there.

    Raises:
        DeltaidError: the mechanism is the user's own, or its friction has terms that URDF lacks.
    """
    tree, forces = spanning_tree(subject), joint_forces(subject, "URDF")
    drawn = shapes(subject, tree)
    points = [point for cut in tree.cuts for point in (cut.first, cut.second)]
    root = element(
        "robot",
        *colours(),
        element("link", name=_WORLD),
        element(
            "link",
            _placeholder(),
            *(visual(shape) for shape in drawn if not shape.body),
            name=_BASE,
        ),
        _fixed(_BASE, _WORLD, np.zeros(3)),
        *(
            part
            for body in tree.bodies
            for part in _link_and_joints(subject, tree, body, drawn, forces)
        ),
        *(part for strut in _pairs(tree) for part in _drawn_strut(subject, strut)),
        *(
            part
            for point in points
            for part in (
                element("link", name=point.name),
                _fixed(point.name, point.body, point.position),
            )
        ),
        element("link", name="tool0"),
        _fixed("tool0", tool_body(tree), np.zeros(3)),
        *control(subject, tree.joint_coordinates(subject.home), forces),
        name=subject.name,
        # Drake reads the inertia of motors and gears from its own names, which others pass over.
        **{"xmlns:drake": "http://drake.mit.edu"},
    )
    root.insert(0, ET.Comment(xml_comment(subject.provenance)))
    ET.indent(root)
    text = '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    loops = _loops(subject, tree, forces, _placeholders(root))
    return Export({".urdf": text, ".loops.json": loops}, _warnings(forces))


def _link_and_joints(
    subject: Model,
    tree: Tree,
    body: TreeBody,
    drawn: tuple[Shape, ...],
    forces: dict[str, JointForces],
) -> Iterator[ET.Element]:
    """Links without mass of their own between the joints, the body on the last one."""
    parent, R, r = body.parent or _BASE, body.R, body.r
    following = {c.joint: c for c in tree.couplings}
    for k, joint in enumerate(body.joints):
        last = k == len(body.joints) - 1
        name = body.name if last else f"{body.name}_{joint.name}"
        if last:
            inertia = RigidBody(body.p)
            shown = (*drawn, *_single(subject, tree, body))
            yield element(
                "link",
                _inertial(inertia.com, inertia.mass, inertia.about_com),
                *(visual(shape) for shape in shown if shape.body == body.name),
                name=name,
            )
        else:
            yield element("link", _placeholder(), name=name)
        moved = element("joint", name=joint.name, type=_kind(subject.robot, joint))
        moved.extend([*_place(parent, name, R, r), element("axis", xyz=joint.axis)])
        moved.extend(_limit(subject.robot, joint))
        if joint.name in following:
            moved.append(_mimic(following[joint.name].follows, following[joint.name].ratio))
        own = forces.get(joint.name)
        if own and (own.viscous or own.coulomb):
            moved.append(element("dynamics", damping=own.viscous, friction=own.coulomb))
        yield moved
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


def _drawn_strut(subject: Model, strut: TreeStrut) -> Iterator[ET.Element]:
    """One of a pair, to look at: beside the middle along y, tilting as the middle does.

    The pair's inertia is that of the body in their middle, which moves as they do.
    """
    limb = int(strut.body[1:])
    geometry = subject.robot.limb_geometry[limb - 1]
    line = geometry.strut * np.eye(3)[0]
    rod = Rod(strut.name, strut.name, "strut", np.zeros(3), line, strut_radius(subject))
    yield element("link", _placeholder(), visual(rod), name=strut.name)
    side = strut.first.position - geometry.upper_arm * np.eye(3)[0]
    yield element(
        "joint",
        *_place(f"{strut.body}_limb{limb}_swing", strut.name, np.eye(3), side),
        element("axis", xyz="0.0 0.0 1.0"),
        _mimic(f"limb{limb}_tilt", 1.0),
        name=f"{strut.name}_tilt",
        type="continuous",
    )


def _mimic(follows: str, ratio: float) -> ET.Element:
    return element("mimic", joint=follows, multiplier=ratio, offset="0.0")


def _fixed(link: str, on: str, position: Float[np.ndarray, " 3"]) -> ET.Element:
    parts = _place(on, link, np.eye(3), position)
    return element("joint", *parts, name=f"{link}_fixed", type="fixed")


def _placeholder() -> ET.Element:
    mass, moment = PLACEHOLDER
    return _inertial(np.zeros(3), mass, moment * np.eye(3))


def _placeholders(root: ET.Element) -> list[str]:
    mass = numbers(PLACEHOLDER[:1])
    found = {link.get("name", ""): link.find("inertial/mass") for link in root.iter("link")}
    return [
        name
        for name, mass_element in found.items()
        if mass_element is not None and mass_element.get("value") == mass
    ]


def _inertial(com: Float[np.ndarray, " 3"], mass: float, T: Float[np.ndarray, "3 3"]) -> ET.Element:
    """Mass, and inertia about the centre of mass in the link's axes."""
    entries = {
        f"i{a}{b}": T[i, j] for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j
    }
    return element(
        "inertial",
        element("origin", xyz=com, rpy=np.zeros(3)),
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
    limits, turns = robot.limits_of(joint.name), not joint.slides
    if joint.name not in robot.drives and turns:
        return
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
