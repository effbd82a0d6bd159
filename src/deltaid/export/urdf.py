"""A model as URDF, which only knows trees, with a JSON file beside it for what closes the loops.

Links are the tree's bodies in their link frames. A body on several joints has links without mass
between them, and every point where a loop was cut is a fixed frame. The file beside it names the
pairs of frames that coincide, the joints that follow others, the home pose, and what URDF has no
words for: inertia of motors and gears, springs.
"""

import json
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.errors import Doubt
from deltaid.export.joint_forces import JointForces, joint_forces
from deltaid.export.spanning_tree import spanning_tree
from deltaid.export.text import numbers, xml_comment
from deltaid.export.tree import Tree, TreeBody, TreeJoint
from deltaid.model.model import Model
from deltaid.robot.body_inertia import body_inertia
from deltaid.robot.description import RobotDescription

_BASE = "base"
# Radius of the lines that are drawn [m].
_RADIUS = 0.01
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
    root = ET.Element("robot", name=subject.name)
    root.append(ET.Comment(xml_comment(subject.provenance)))
    ET.SubElement(root, "link", name=_BASE)
    for body in tree.bodies:
        _link_and_joints(root, subject.robot, body, forces)
    for point in (point for cut in tree.cuts for point in (cut.first, cut.second)):
        ET.SubElement(root, "link", name=point.name)
        fixed = ET.SubElement(root, "joint", name=f"{point.name}_fixed", type="fixed")
        _place(fixed, point.body, point.name, np.eye(3), point.position)
    ET.indent(root)
    text = '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    return UrdfExport(text, _loops(subject, tree, forces), _warnings(forces))


def _link_and_joints(
    root: ET.Element, robot: RobotDescription, body: TreeBody, forces: dict[str, JointForces]
) -> None:
    """Links without mass between the joints, the body on the last one."""
    parent, R, r = body.parent or _BASE, body.R, body.r
    for k, joint in enumerate(body.joints):
        last = k == len(body.joints) - 1
        name = body.name if last else f"{body.name}_{joint.name}"
        link = ET.SubElement(root, "link", name=name)
        if last:
            _inertial(link, body)
            _visual(link, body)
        element = ET.SubElement(root, "joint", name=joint.name, type=_kind(robot, joint))
        _place(element, parent, name, R, r)
        ET.SubElement(element, "axis", xyz=numbers(joint.axis))
        _limit(element, robot, joint)
        own = forces.get(joint.name)
        if own and (own.viscous or own.coulomb):
            values = {"damping": numbers([own.viscous]), "friction": numbers([own.coulomb])}
            ET.SubElement(element, "dynamics", values)
        parent, R, r = name, np.eye(3), np.zeros(3)


def _inertial(link: ET.Element, body: TreeBody) -> None:
    """Mass, and inertia about the centre of mass in the link's axes."""
    inertia = body_inertia(body.p)
    element, T = ET.SubElement(link, "inertial"), inertia.about_com
    ET.SubElement(element, "origin", xyz=numbers(inertia.com), rpy=numbers(np.zeros(3)))
    ET.SubElement(element, "mass", value=numbers([inertia.mass]))
    entries = {
        f"i{a}{b}": (i, j) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j
    }
    ET.SubElement(element, "inertia", {key: numbers([T[place]]) for key, place in entries.items()})


def _visual(link: ET.Element, body: TreeBody) -> None:
    """A thin cylinder for each line; URDF's stand along z about their middle."""
    for start, end in body.lines:
        length = float(np.linalg.norm(end - start))
        if length < 1e-6:
            continue
        turn, _ = Rotation.align_vectors([(end - start) / length], [[0.0, 0.0, 1.0]])
        visual = ET.SubElement(link, "visual")
        rpy = numbers(_rpy(turn.as_matrix()))
        ET.SubElement(visual, "origin", xyz=numbers(0.5 * (start + end)), rpy=rpy)
        geometry = ET.SubElement(visual, "geometry")
        values = {"radius": numbers([_RADIUS]), "length": numbers([length])}
        ET.SubElement(geometry, "cylinder", values)


def _place(
    element: ET.Element,
    parent: str,
    child: str,
    R: Float[np.ndarray, "3 3"],
    r: Float[np.ndarray, " 3"],
) -> None:
    """A joint's frame in its parent link; URDF's roll, pitch and yaw are about fixed axes."""
    ET.SubElement(element, "origin", xyz=numbers(r), rpy=numbers(_rpy(R)))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)


def _rpy(R: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Roll, pitch and yaw with R = R_z(yaw) R_y(pitch) R_x(roll); exact at pitch 90° as well."""
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return float(roll), float(pitch), float(yaw)


def _kind(robot: RobotDescription, joint: TreeJoint) -> str:
    if joint.slides:
        return "prismatic"
    limits = robot.drive_limits.get(joint.name)
    return "revolute" if limits and limits.range else "continuous"


def _limit(element: ET.Element, robot: RobotDescription, joint: TreeJoint) -> None:
    limits = robot.drive_limits.get(joint.name)
    low, high = (limits and limits.range) or (-_FAR, _FAR)
    effort = (limits and limits.effort) or _STRONG
    speed = (limits and limits.top_speed) or _FAST
    values = {"effort": numbers([effort]), "velocity": numbers([speed])}
    if _kind(robot, joint) != "continuous":
        values |= {"lower": numbers([low]), "upper": numbers([high])}
    ET.SubElement(element, "limit", values)


def _loops(subject: Model, tree: Tree, forces: dict[str, JointForces]) -> str:
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
        "home": tree.at(subject.home),
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
