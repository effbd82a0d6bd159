"""A model as MJCF: the spanning tree with its loops closed by equality constraints of MuJoCo.

The model's own pose (qpos0) is the home pose with closed loops, and joint coordinates count as in
deltaid by `ref`, so an arm is level at zero.
"""

from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.export.joint_forces import JointForces, joint_forces
from deltaid.export.spanning_tree import spanning_tree
from deltaid.export.text import numbers, xml_comment
from deltaid.export.tree import Tree, TreeBody, TreeJoint
from deltaid.model.model import Model
from deltaid.robot.body_inertia import body_inertia

# Step [s]. MuJoCo's constraints are springs with dampers; the time constant is the smallest that it
# allows at this step, and the impedance leaves a share of 1e-4 of what a rigid joint would feel.
_STEP = 0.001
_SOLREF, _SOLIMP = (2 * _STEP, 1.0), (0.9999, 0.9999, 0.001)


def mjcf(subject: Model) -> str:
    """The text of an MJCF file.

    Raises:
        DeltaidError: the mechanism is the user's own, or its friction has terms that MuJoCo lacks.
    """
    tree, forces = spanning_tree(subject), joint_forces(subject, "MJCF")
    home = tree.at(subject.home)
    root = ET.Element("mujoco", model=subject.name)
    root.append(ET.Comment(xml_comment(subject.provenance)))
    ET.SubElement(
        root,
        "compiler",
        angle="radian",
        autolimits="true",
        balanceinertia="false",
        inertiafromgeom="false",
    )
    ET.SubElement(
        root,
        "option",
        timestep=numbers([_STEP]),
        gravity=numbers(subject.robot.gravity),
        integrator="implicitfast",
    )
    _defaults(root)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 2", dir="0 0 -1", directional="true")
    order: list[str] = []
    for body in tree.children(""):
        _body(world, subject, tree, body, forces, home, order)
    _equality(root, tree)
    _actuators(root, subject)
    keyframe = ET.SubElement(root, "keyframe")
    ET.SubElement(keyframe, "key", name="home", qpos=numbers(home[name] for name in order))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _defaults(root: ET.Element) -> None:
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "equality", solref=numbers(_SOLREF), solimp=numbers(_SOLIMP))
    ET.SubElement(
        default, "joint", solreffriction=numbers(_SOLREF), solimpfriction=numbers(_SOLIMP)
    )
    ET.SubElement(default, "geom", contype="0", conaffinity="0", size="0.01")
    ET.SubElement(default, "site", size="0.012")


def _body(
    parent: ET.Element,
    subject: Model,
    tree: Tree,
    body: TreeBody,
    forces: dict[str, JointForces],
    home: dict[str, float],
    order: list[str],
) -> None:
    """A body and all on it; `order` collects joints as MuJoCo counts them.

    MuJoCo wants the frame where the joints are at `ref`, and every axis in that frame.
    """
    R, r, axes = _at_home(body, home)
    inertia = body_inertia(body.p)
    T = inertia.about_com
    entries = [T[0, 0], T[1, 1], T[2, 2], T[0, 1], T[0, 2], T[1, 2]]
    quat = np.roll(Rotation.from_matrix(R).as_quat(), 1)  # MuJoCo has the scalar first
    element = ET.SubElement(parent, "body", name=body.name, pos=numbers(r), quat=numbers(quat))
    ET.SubElement(
        element,
        "inertial",
        pos=numbers(inertia.com),
        mass=numbers([inertia.mass]),
        fullinertia=numbers(entries),
    )
    for joint, axis in zip(body.joints, axes, strict=True):
        order.append(joint.name)
        _joint(element, subject, joint, axis, forces, home)
    for start, end in body.lines:
        if np.linalg.norm(end - start) > 1e-6:
            fromto = numbers([*start, *end])
            ET.SubElement(element, "geom", type="capsule", fromto=fromto)
    if not body.lines:
        ET.SubElement(element, "geom", type="sphere", size="0.025")
    for point in (point for cut in tree.cuts for point in (cut.first, cut.second)):
        if point.body == body.name:
            ET.SubElement(element, "site", name=point.name, pos=numbers(point.position))
    for child in tree.children(body.name):
        _body(element, subject, tree, child, forces, home, order)


def _at_home(
    body: TreeBody, home: dict[str, float]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"], list[Float[np.ndarray, " 3"]]]:
    """Pose in the parent with the joints at home, and the joints' axes in the link frame there."""
    R, r, axes = body.R, body.r, []
    for joint in body.joints:
        axes.append(R @ joint.axis)
        if joint.slides:
            r = r + home[joint.name] * axes[-1]
        else:
            R = R @ Rotation.from_rotvec(home[joint.name] * joint.axis).as_matrix()
    return R, r, [R.T @ axis for axis in axes]


def _joint(
    element: ET.Element,
    subject: Model,
    joint: TreeJoint,
    axis: Float[np.ndarray, " 3"],
    forces: dict[str, JointForces],
    home: dict[str, float],
) -> None:
    """A joint; its coordinate at the model's own pose is `ref`."""
    found = ET.SubElement(
        element,
        "joint",
        name=joint.name,
        type="slide" if joint.slides else "hinge",
        axis=numbers(axis),
        ref=numbers([home[joint.name]]),
    )
    own = forces.get(joint.name, JointForces())
    for key, value in (
        ("damping", own.viscous),
        ("frictionloss", own.coulomb),
        ("armature", own.armature),
        ("stiffness", own.stiffness),
    ):
        if value:
            found.set(key, numbers([value]))
    if own.stiffness:
        found.set("springref", numbers([own.rest]))
    limits = subject.robot.drive_limits.get(joint.name)
    if limits and limits.range:
        found.set("range", numbers(limits.range))


def _equality(root: ET.Element, tree: Tree) -> None:
    equality = ET.SubElement(root, "equality")
    for cut in tree.cuts:
        ET.SubElement(
            equality, "connect", name=cut.name, site1=cut.first.name, site2=cut.second.name
        )
    for coupling in tree.couplings:
        ET.SubElement(
            equality,
            "joint",
            name=coupling.joint,
            joint1=coupling.joint,
            joint2=coupling.follows,
            polycoef=numbers([0.0, coupling.ratio, 0.0, 0.0, 0.0]),
        )


def _actuators(root: ET.Element, subject: Model) -> None:
    """A motor a drive: its control is the torque [N m] or force [N] at the joint."""
    actuators = ET.SubElement(root, "actuator")
    for drive in subject.robot.drives:
        motor = ET.SubElement(actuators, "motor", name=drive, joint=drive, gear="1")
        limits = subject.robot.drive_limits.get(drive)
        if limits and limits.effort:
            for key in ("ctrlrange", "forcerange"):
                motor.set(key, numbers([-limits.effort, limits.effort]))
