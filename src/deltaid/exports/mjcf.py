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
from deltaid.exports.mjcf_scene import assets, extent, geom, middle, scalar_first, scene, struts
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import element, xml_comment
from deltaid.exports.tree import spanning_tree
from deltaid.exports.tree_parts import Tree, TreeBody, TreeJoint, TreePoint
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
    drawn = shapes(subject, tree)
    seen = extent(subject, drawn)
    order: list[str] = []
    base = element(
        "body",
        *(geom(shape) for shape in drawn if not shape.body),
        *(_body(subject, tree, body, drawn, forces, home, order) for body in tree.children("")),
        name="base",
    )
    root = element(
        "mujoco",
        element(
            "compiler",
            angle="radian",
            autolimits="true",
            inertiafromgeom="auto",  # bodies without `inertial` are frames without shapes
        ),
        element("option", timestep=_STEP, gravity=subject.robot.gravity, integrator="implicitfast"),
        element(
            "default",
            element("equality", solref=_SOLREF, solimp=_SOLIMP),
            element("joint", solreffriction=_SOLREF, solimpfriction=_SOLIMP),
            element("geom", contype="0", conaffinity="0", mass="0", group="1"),
            element("site", size="0.004", group="4"),
        ),
        *assets(seen),
        element("worldbody", *scene(seen), base),
        struts(subject, tree),
        _equality(tree),
        _actuators(subject),
        _sensors(subject, tree),
        element("keyframe", element("key", name="home", qpos=[home[name] for name in order])),
        model=subject.name,
    )
    root.insert(0, ET.Comment(xml_comment(subject.provenance)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _body(
    subject: Model,
    tree: Tree,
    body: TreeBody,
    drawn: tuple[Shape, ...],
    forces: dict[str, JointForces],
    home: dict[str, float],
    order: list[str],
) -> ET.Element:
    """A body and all on it; `order` collects joints as MuJoCo counts them.

    MuJoCo wants the frame where the joints are at `ref`, and every axis in that frame.
    """
    R, r, axes = _at_home(body, home)
    inertia = RigidBody(body.p)
    T = inertia.about_com
    entries = [T[0, 0], T[1, 1], T[2, 2], T[0, 1], T[0, 2], T[1, 2]]
    order += [joint.name for joint in body.joints]
    parts = [
        element("inertial", pos=inertia.com, mass=inertia.mass, fullinertia=entries),
        *(_joint(subject, *both, forces, home) for both in zip(body.joints, axes, strict=True)),
        *(geom(shape) for shape in drawn if shape.body == body.name),
        *(
            middle(subject, body.name, float(cut.first.position[0]))
            for cut in tree.cuts
            if cut.first.body == body.name and cut.first.name.endswith("_strut")
        ),
        *(
            element("site", name=point.name, pos=point.position)
            for point in _points(tree)
            if point.body == body.name
        ),
    ]
    if any(strut.body == body.name for strut in tree.struts):  # turned by 180° about z
        parts.append(element("site", name=f"{body.name}_pull", quat="0 0 0 1"))
    children = tree.children(body.name)
    parts += [_body(subject, tree, child, drawn, forces, home, order) for child in children]
    quat = scalar_first(R)
    if not _needs_mount(body, R):
        return element("body", *parts, name=body.name, pos=r, quat=quat)
    mounted = element("body", *parts, name=body.name)
    return element("body", mounted, name=f"{body.name}_mount", pos=r, quat=quat)


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
    subject: Model,
    joint: TreeJoint,
    axis: Float[np.ndarray, " 3"],
    forces: dict[str, JointForces],
    home: dict[str, float],
) -> ET.Element:
    """A joint; its coordinate at the model's own pose is `ref`."""
    own, limits = forces.get(joint.name, JointForces()), subject.robot.limits_of(joint.name)
    return element(
        "joint",
        name=joint.name,
        type="slide" if joint.slides else "hinge",
        axis=axis,
        ref=home[joint.name],
        damping=own.viscous or None,
        frictionloss=own.coulomb or None,
        armature=own.armature or None,
        stiffness=own.stiffness or None,
        springref=own.rest if own.stiffness else None,
        range=limits.range,
    )


def _equality(tree: Tree) -> ET.Element:
    return element(
        "equality",
        *(
            element(
                "connect",
                name=cut.name,
                body1=cut.first.body,
                body2=cut.second.body,
                anchor=cut.first.position,
            )
            for cut in tree.cuts
        ),
        *(
            element(
                "joint",
                name=coupling.joint,
                joint1=coupling.joint,
                joint2=coupling.follows,
                polycoef=[0.0, coupling.ratio, 0.0, 0.0, 0.0],
            )
            for coupling in tree.couplings
        ),
    )


def _actuators(subject: Model) -> ET.Element:
    """A motor a drive: its control is the torque [N m] or force [N] at the joint."""
    motors = []
    for drive in subject.robot.drives:
        effort = subject.robot.limits_of(drive).effort
        span = [-effort, effort] if effort else None
        motors.append(
            element("motor", name=drive, joint=drive, gear="1", ctrlrange=span, forcerange=span)
        )
    return element("actuator", *motors)


def _sensors(subject: Model, tree: Tree) -> ET.Element:
    """Drives, what the struts of each limb carry together, and where the tool is.

    A force sensor has the force of the driven body on the struts in the axes of the site, whose x
    points up the struts: pull is positive. Joints keep the platform upright here, not pairs of
    struts, so how a pair shares its force is not known.
    """
    sensors = []
    for drive in subject.robot.drives:
        sensors += [
            element("jointpos", name=f"{drive}_position", joint=drive),
            element("jointvel", name=f"{drive}_velocity", joint=drive),
            element("actuatorfrc", name=f"{drive}_effort", actuator=drive),
        ]
    limbs = dict.fromkeys(strut.body for strut in tree.struts)
    tool = {"objtype": "site", "objname": "tool"}
    return element(
        "sensor",
        *sensors,
        *(element("force", name=f"strut{limb[1:]}_force", site=f"{limb}_pull") for limb in limbs),
        element("framepos", name="tool_position", **tool),
        element("framequat", name="tool_orientation", **tool),
        element("framelinvel", name="tool_velocity", **tool),
    )


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
