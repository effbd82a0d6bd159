"""A model as URDF, which only represents trees, with a JSON file for the closed loops.

Links are the tree's bodies in their link frames, on a base that is fixed in `world`. A body with
several joints has links between them, and every point of a cut loop is a fixed frame. The JSON file
names the pairs of frames that coincide, the joints that follow others, the home pose, and
quantities that URDF lacks: inertia of motors and gears, springs.

Links between joints have no mass in the model. Gazebo removes a link below 1e-6 kg with all its
children, so they have the smallest possible placeholder mass; the JSON file names them. Fixed
frames have none: they are part of the link that they are fixed to.

Drives have `ros2_control` for ROS 2, `transmission` for Drake and ROS 1. All their quantities are
those of the joint, so every transmission has the ratio 1, and the inertia of motor and gear is
related to the joint. URDF's roll, pitch and yaw are about fixed axes.
"""

import json
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.errors import Doubt
from deltaid.exports.looks import COLOURS, Ball, Rod, Shape, shapes, strut_radius
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import Export, numbers, rendered_xml, xml_text
from deltaid.exports.tree import ZERO, I, Tree, TreeBody, TreeJoint, X, spanning_tree
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.part import LONGEST
from deltaid.sensors.weighings import roll_pitch_yaw

# Mass [kg], above the 1e-6 kg that Gazebo drops, and moments about the centre of mass [kg m²] of
# links without mass in the model.
PLACEHOLDER = (2e-6, 1e-10)
# URDF requires limits of sliding joints; those of passive ones exceed any robot: force [N], speed
# [m/s], and its longest length.
_STRONG, _FAST = 1e6, 1e3


def urdf(subject: Model) -> Export:
    """A model as URDF (XML), with its loops as JSON; warnings name quantities that only the JSON
    has.

    Raises:
        DeltaidError: the mechanism is user-defined, or its friction has terms that URDF lacks.
    """
    tree, forces, robot = spanning_tree(subject), joint_forces(subject, "URDF"), subject.robot
    drawn, pairs = [*shapes(subject, tree)], []
    for strut in tree.struts:  # one strut of a pair has its own link, for its shape
        limb = robot.limb_geometry[int(strut.body[1:]) - 1]
        link = strut.body if limb.struts == 1 else strut.name
        line, radius = limb.strut * X, strut_radius(subject)
        drawn.append(Rod(link, strut.name, "strut", ZERO, line, radius))
        if limb.struts > 1:
            pairs.append((strut, strut.first.position - limb.upper_arm * X))
    root = rendered_xml(
        "urdf.xml.jinja",
        name=subject.name,
        robot=robot,
        tree=tree,
        forces=forces,
        home=tree.home,
        drawn=drawn,
        pairs=pairs,
        colours=COLOURS,
        placeholder=PLACEHOLDER,
        zero=ZERO,
        identity=I,
        rigid=RigidBody,
        rpy=roll_pitch_yaw,
        chain=_chain,
        kind=partial(_kind, robot),
        limit=partial(_limit, robot),
        formed=_formed,
    )
    # Drake reads the inertia of motors and gears under its own names, which other programs ignore.
    root.set("xmlns:drake", "http://drake.mit.edu")
    for rotor in root.iter("rotor_inertia"):
        rotor.tag = "drake:rotor_inertia"
    loops = _loops(subject, tree, forces)
    loops["drawn_joints"] = [f"{strut.name}_tilt" for strut, _ in pairs]
    empty = numbers(PLACEHOLDER[:1])
    masses = {link.get("name", ""): link.find("inertial/mass") for link in root.iter("link")}
    loops["placeholder_links"] = [
        name for name, mass in masses.items() if mass is not None and mass.get("value") == empty
    ]
    written = xml_text(root, '<?xml version="1.0"?>\n', subject.provenance)
    text = json.dumps(loops, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return Export({".urdf": written, ".loops.json": text}, _warnings(forces))


def _loops(subject: Model, tree: Tree, forces: Mapping[str, JointForces]) -> dict[str, Any]:
    """Closed loops, the home pose, and quantities that URDF lacks."""
    robot = subject.robot
    return {
        "robot": subject.name,
        "provenance": subject.provenance,
        "gravity": list(robot.gravity),
        "drives": list(robot.drives),
        "coincident_frames": [
            {"name": cut.name, "frames": [cut.first.name, cut.second.name]} for cut in tree.cuts
        ],
        "following_joints": [
            {"joint": c.joint, "follows": c.follows, "ratio": c.ratio} for c in tree.couplings
        ],
        "drawn_joints": [],
        "placeholder_links": [],
        "home": tree.home,
        "armature": {joint: f.armature for joint, f in forces.items() if f.armature},
        "springs": {
            joint: {"stiffness": f.stiffness, "rest": f.rest}
            for joint, f in forces.items()
            if f.stiffness
        },
    }


def _chain(
    body: TreeBody,
) -> Iterator[tuple[TreeJoint, str, str, Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]]:
    """Joints of a body, each with the link that it moves, its parent, and its pose there."""
    parent, R, r = body.parent or "base", body.R, body.r
    for joint in body.joints:
        name = body.name if joint is body.joints[-1] else f"{body.name}_{joint.name}"
        yield joint, name, parent, R, r
        parent, R, r = name, I, ZERO


def _kind(robot: RobotDescription, joint: TreeJoint) -> str:
    if joint.slides:
        return "prismatic"
    return "revolute" if robot.limits_of(joint.name).range else "continuous"


def _limit(robot: RobotDescription, joint: TreeJoint) -> dict[str, float]:
    """Limits of drives and of a bar's stroke, as described; URDF requires limits of sliding
    joints."""
    if joint.name not in robot.drives and not joint.slides:
        return {}
    limits = robot.limits_of(joint.name)
    low, high = limits.range or (-LONGEST, LONGEST)
    if joint.name == "slide" and robot.telescope is not None and robot.telescope.stroke:
        low, high = robot.telescope.stroke
    most = {"effort": limits.effort or _STRONG, "velocity": limits.top_speed or _FAST}
    return most if _kind(robot, joint) == "continuous" else most | {"lower": low, "upper": high}


def _formed(shape: Shape) -> tuple[Any, ...]:
    """Centre, rotation, form and size of a shape; cylinders of URDF are centred along z."""
    match shape:
        case Rod():
            along = shape.end - shape.start
            length = float(np.linalg.norm(along))
            turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
            size, centre = {"radius": shape.radius, "length": length}, shape.start + shape.end
            return 0.5 * centre, turn.as_matrix(), "cylinder", size
        case Ball():
            return shape.centre, I, "sphere", {"radius": shape.radius}
        case _:
            return shape.centre, shape.R, "box", {"size": 2 * shape.half}


def _warnings(forces: dict[str, JointForces]) -> tuple[str, ...]:
    """Quantities that a program misses, besides the loops, if it reads the URDF alone."""
    missing = {
        "inertia of motors and gears": [j for j, f in forces.items() if f.armature],
        "springs": [j for j, f in forces.items() if f.stiffness],
    }
    return tuple(
        Doubt(
            f"{what} of {', '.join(joints)} are not in the URDF but in the file of the loops",
            cause="URDF has no words for them",
            cure="let the program that reads the URDF read that file as well",
        )
        for what, joints in missing.items()
        if joints
    )
