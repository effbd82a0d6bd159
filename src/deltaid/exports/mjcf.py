"""A model as MJCF: the spanning tree with its loops closed by equality constraints of MuJoCo.

The model's own pose (qpos0) is the home pose with closed loops, and joint coordinates count as in
deltaid by `ref`, so an arm is level at zero.

Drawn models are a folder of such files, for programs that train or test on many robots.
"""

import csv
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import Shape, shapes
from deltaid.exports.mjcf_scene import assets, extent, geom, middle, scalar_first, scene, struts
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import element, xml_text
from deltaid.exports.tree import (
    ZERO,
    I,
    Tree,
    TreeBody,
    TreeJoint,
    TreePoint,
    require_physical,
    spanning_tree,
)
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
        element(
            "worldbody",
            *scene(seen),
            element(
                "body",
                *(geom(shape) for shape in drawn if not shape.body),
                *_bodies(subject, tree, "", drawn, forces, home, order),
                name="base",
            ),
        ),
        struts(subject, tree),
        _equality(tree),
        _actuators(subject),
        _sensors(subject, tree),
        element("keyframe", element("key", name="home", qpos=[home[name] for name in order])),
        model=subject.name,
    )
    return xml_text(root, comment=subject.provenance)


def _bodies(
    subject: Model,
    tree: Tree,
    parent: str,
    drawn: tuple[Shape, ...],
    forces: dict[str, JointForces],
    home: dict[str, float],
    order: list[str],
) -> list[ET.Element]:
    """All bodies on one, with all on them; `order` collects joints as MuJoCo counts them.

    MuJoCo wants the frame where the joints are at `ref`, and every axis in that frame.
    """
    points = [p for pair in (*tree.cuts, *tree.struts) for p in (pair.first, pair.second)]
    points.append(TreePoint("tool", tree.tool_body, ZERO))
    made = []
    for body in tree.bodies:
        if body.parent != parent:
            continue
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
                for point in points
                if point.body == body.name
            ),
        ]
        if any(strut.body == body.name for strut in tree.struts):  # turned by 180° about z
            parts.append(element("site", name=f"{body.name}_pull", quat="0 0 0 1"))
        parts += _bodies(subject, tree, body.name, drawn, forces, home, order)
        place = {"pos": r, "quat": scalar_first(R)}
        if _needs_mount(body, R):
            mounted = element("body", *parts, name=body.name)
            made.append(element("body", mounted, name=f"{body.name}_mount", **place))
        else:
            made.append(element("body", *parts, name=body.name, **place))
    return made


def _needs_mount(body: TreeBody, R: Float[np.ndarray, "3 3"]) -> bool:
    """Whether a frame that is fixed in the parent has to carry the body's pose.

    MuJoCo counts all joints of a body in the body's frame. Drake makes a body of each joint and has
    all of them but the last in the parent's frame, so these two frames must be one.
    """
    turned = not np.array_equal(R, I)
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
    own = forces.get(joint.name, JointForces())
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
        range=subject.robot.limits_of(joint.name).range,
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
    efforts = {drive: subject.robot.limits_of(drive).effort for drive in subject.robot.drives}
    spans = {drive: [-most, most] if most else None for drive, most in efforts.items()}
    return element(
        "actuator",
        *(
            element("motor", name=drive, joint=drive, gear="1", ctrlrange=span, forcerange=span)
            for drive, span in spans.items()
        ),
    )


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
        (place / "index.csv").open("w", encoding="utf-8", newline="") as file,
    ):
        index = csv.writer(file, lineterminator="\n")
        index.writerow(["file", *samples.names])
        for i, model in enumerate(samples.models(), 1):
            require_physical(model, "draw with another --seed, or fewer models")
            name = f"model_{i:0{digits}}.xml"
            (place / name).write_text(mjcf(model), encoding="utf-8")
            index.writerow([name, *map(repr, model.p.tolist())])
    return Path(folder)
