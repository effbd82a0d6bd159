"""A model as MJCF: the spanning tree with its loops closed by equality constraints of MuJoCo.

The model's own pose (qpos0) is the home pose with closed loops, and joint coordinates count as in
deltaid by `ref`, so an arm is level at zero.

Drawn models are a folder of such files, for programs that train or test on many robots.
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.errors import DeltaidError
from deltaid.exports.looks import Shape, shapes, tool_body
from deltaid.exports.mjcf_scene import assets, draw, draw_middle, extent, scene, struts
from deltaid.exports.spanning_tree import spanning_tree
from deltaid.exports.text import numbers, xml_comment
from deltaid.exports.tree import JointForces, Tree, TreeBody, TreeJoint, TreePoint, joint_forces
from deltaid.files import new_folder
from deltaid.model.model import Model
from deltaid.model.samples import Samples
from deltaid.robot.inertia import RigidBody

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
    home = tree.joint_coordinates(subject.home)
    root = ET.Element("mujoco", model=subject.name)
    root.append(ET.Comment(xml_comment(subject.provenance)))
    ET.SubElement(
        root,
        "compiler",
        angle="radian",
        autolimits="true",
        inertiafromgeom="auto",  # bodies without `inertial` are frames without shapes
    )
    ET.SubElement(
        root,
        "option",
        timestep=numbers([_STEP]),
        gravity=numbers(subject.robot.gravity),
        integrator="implicitfast",
    )
    _defaults(root)
    drawn = shapes(subject, tree)
    seen = extent(subject, drawn)
    assets(root, seen)
    world = ET.SubElement(root, "worldbody")
    scene(world, seen)
    base = ET.SubElement(world, "body", name="base")
    for shape in drawn:
        if not shape.body:
            draw(base, shape)
    order: list[str] = []
    for body in tree.children(""):
        _body(base, subject, tree, body, drawn, forces, home, order)
    struts(root, subject, tree)
    _equality(root, tree)
    _actuators(root, subject)
    _sensors(root, subject, tree)
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
    ET.SubElement(default, "geom", contype="0", conaffinity="0", mass="0", group="1")
    ET.SubElement(default, "site", size="0.004", group="4")


def _body(
    parent: ET.Element,
    subject: Model,
    tree: Tree,
    body: TreeBody,
    drawn: tuple[Shape, ...],
    forces: dict[str, JointForces],
    home: dict[str, float],
    order: list[str],
) -> None:
    """A body and all on it; `order` collects joints as MuJoCo counts them.

    MuJoCo wants the frame where the joints are at `ref`, and every axis in that frame.
    """
    R, r, axes = _at_home(body, home)
    inertia = RigidBody(body.p)
    T = inertia.about_com
    entries = [T[0, 0], T[1, 1], T[2, 2], T[0, 1], T[0, 2], T[1, 2]]
    quat = np.roll(Rotation.from_matrix(R).as_quat(), 1)  # MuJoCo has the scalar first
    place = {"pos": numbers(r), "quat": numbers(quat)}
    if _needs_mount(body, R):
        parent = ET.SubElement(parent, "body", {"name": f"{body.name}_mount"} | place)
        place = {}
    element = ET.SubElement(parent, "body", {"name": body.name} | place)
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
    for shape in drawn:
        if shape.body == body.name:
            draw(element, shape)
    for cut in tree.cuts:
        if cut.first.body == body.name and cut.first.name.endswith("_strut"):
            draw_middle(element, subject, body.name, float(cut.first.position[0]))
    for point in _points(tree):
        if point.body == body.name:
            ET.SubElement(element, "site", name=point.name, pos=numbers(point.position))
    if any(strut.body == body.name for strut in tree.struts):  # turned by 180° about z
        ET.SubElement(element, "site", name=f"{body.name}_pull", quat="0 0 0 1")
    for child in tree.children(body.name):
        _body(element, subject, tree, child, drawn, forces, home, order)


def _points(tree: Tree) -> Iterator[TreePoint]:
    """Sites: where loops are cut, ends of struts, the tool."""
    for cut in tree.cuts:
        yield from (cut.first, cut.second)
    for strut in tree.struts:
        yield from (strut.first, strut.second)
    yield TreePoint("tool", tool_body(tree), np.zeros(3))


def _needs_mount(body: TreeBody, R: Float[np.ndarray, "3 3"]) -> bool:
    """Whether a frame that is fixed in the parent has to carry the body's pose.

    MuJoCo counts all joints of a body in the body's frame. Drake makes a body of each joint and has
    all of them but the last in the parent's frame, so these two frames must be one.
    """
    turned = not np.array_equal(R, np.eye(3))
    return len(body.joints) > 1 and (turned or not all(j.slides for j in body.joints[:-1]))


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
            equality,
            "connect",
            name=cut.name,
            body1=cut.first.body,
            body2=cut.second.body,
            anchor=numbers(cut.first.position),
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


def _sensors(root: ET.Element, subject: Model, tree: Tree) -> None:
    """Drives, what the struts of each limb carry together, and where the tool is.

    A force sensor has the force of the driven body on the struts in the axes of the site, whose x
    points up the struts: pull is positive. Joints keep the platform upright here, not pairs of
    struts, so how a pair shares its force is not known.
    """
    sensors = ET.SubElement(root, "sensor")
    for drive in subject.robot.drives:
        ET.SubElement(sensors, "jointpos", name=f"{drive}_position", joint=drive)
        ET.SubElement(sensors, "jointvel", name=f"{drive}_velocity", joint=drive)
        ET.SubElement(sensors, "actuatorfrc", name=f"{drive}_effort", actuator=drive)
    for body in dict.fromkeys(strut.body for strut in tree.struts):
        ET.SubElement(sensors, "force", name=f"strut{body[1:]}_force", site=f"{body}_pull")
    ET.SubElement(sensors, "framepos", name="tool_position", objtype="site", objname="tool")
    ET.SubElement(sensors, "framequat", name="tool_orientation", objtype="site", objname="tool")
    ET.SubElement(sensors, "framelinvel", name="tool_velocity", objtype="site", objname="tool")


INDEX = "index.csv"


def write_ensemble(samples: Samples, folder: str | Path) -> Path:
    """Write a new folder with a file a model, and an index: file, then all parameters.

    The folder appears with all files in it, or not at all.

    Raises:
        DeltaidError: there is such a folder, it cannot be written, or MJCF lacks what the robot
            has.
    """
    digits = len(str(len(samples)))
    with (
        new_folder(Path(folder)) as place,
        (place / INDEX).open("w", encoding="utf-8", newline="") as file,
    ):
        index = csv.writer(file, lineterminator="\n")
        index.writerow(["file", *samples.names])
        for i, model in enumerate(samples.models()):
            for body in model.layout.bodies:
                if reason := RigidBody(model.body(body)).why_not_physical:
                    raise DeltaidError(
                        f"body {body} cannot be exported: {reason}",
                        where=model.source,
                        cure="draw with another --seed, or fewer models",
                    )
            name = f"model_{i + 1:0{digits}}.xml"
            (place / name).write_text(mjcf(model), encoding="utf-8")
            index.writerow([name, *map(repr, model.p.tolist())])
    return Path(folder)
