"""A model as MJCF: the spanning tree with MuJoCo's equality constraints as loops.

The model's initial pose (qpos0) is the home pose with closed loops, and `ref` makes joint
coordinates equal to those of deltaid, so an arm at zero is level. Shapes have neither mass nor
contacts: inertia is that of the `inertial` elements alone.

Drawn models become a folder of such files, for programs that train or test on many robots.
"""

import csv
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from deltaid.exports.looks import COLOURS, Rod, Shape, shapes, strut_radius, thickness
from deltaid.exports.plain_friction import JointForces, joint_forces
from deltaid.exports.text import numbers, rendered_xml, xml_text
from deltaid.exports.tree import (
    ZERO,
    I,
    TreeBody,
    TreePoint,
    Vector,
    require_physical,
    spanning_tree,
)
from deltaid.files import new_folder
from deltaid.model.model import Model
from deltaid.model.samples import Samples
from deltaid.robot.inertia import RigidBody

# Time step [s]. MuJoCo's constraints are springs with dampers: their time constant is the smallest
# at this step, and the impedance leaves 1e-4 of the force to the compliance.
_STEP = 0.001
_SOLREF, _SOLIMP = (2 * _STEP, 1.0), (0.9999, 0.9999, 0.001)


def mjcf(subject: Model) -> str:
    """The text of an MJCF file.

    Raises:
        DeltaidError: the mechanism is user-defined, or its friction has terms that MuJoCo lacks.
    """
    tree, forces = spanning_tree(subject), joint_forces(subject, "MJCF")
    home, drawn = tree.home, shapes(subject, tree)
    centre, size, floor = _extent(subject, drawn)
    points = [p for pair in (*tree.cuts, *tree.struts) for p in (pair.first, pair.second)]
    root = rendered_xml(
        "mjcf.xml.jinja",
        name=subject.name,
        robot=subject.robot,
        tree=tree,
        forces=forces,
        free=JointForces(),
        home=home,
        drawn=drawn,
        centre=centre,
        size=size,
        floor=floor,
        points=[*points, TreePoint("tool", tree.tool_body, ZERO)],
        limbs=list(dict.fromkeys(strut.body for strut in tree.struts)),
        width=strut_radius(subject),
        colours=COLOURS,
        step=_STEP,
        solref=_SOLREF,
        solimp=_SOLIMP,
        at_home=partial(_at_home, home),
        needs_mount=_needs_mount,
        inertial=_inertial,
        quat=lambda R: np.roll(Rotation.from_matrix(R).as_quat(), 1),  # scalar first
        joined=lambda *ends: np.concatenate(ends),
        light=partial(_light, centre, size),
        camera=partial(_camera, centre, size),
    )
    moved = [joint.get("name", "") for joint in root.iterfind("worldbody//joint")]
    for key in root.iter("key"):  # in the order of MuJoCo's joints
        key.set("qpos", numbers(home[name] for name in moved))
    return xml_text(root, comment=subject.provenance)


def _inertial(body: TreeBody) -> dict[str, Float[np.ndarray, " _"] | float]:
    inertia = RigidBody(body.p)
    entries = inertia.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return {"pos": inertia.com, "mass": inertia.mass, "fullinertia": entries}


def _needs_mount(body: TreeBody, R: Float[np.ndarray, "3 3"]) -> bool:
    """Whether an additional frame, fixed in the parent, must have the body's pose.

    MuJoCo defines all joints of a body in the body's frame. Drake makes a body of each joint and
    defines all joints but the last in the parent's frame, so these two frames must be equal.
    """
    turned = not np.array_equal(R, I)
    return len(body.joints) > 1 and (turned or not all(j.slides for j in body.joints[:-1]))


def _at_home(
    home: dict[str, float], body: TreeBody
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


def _extent(subject: Model, drawn: Iterable[Shape]) -> tuple[Vector, float, float]:
    """Middle of base, elbows and workspace with a margin, their diagonal [m], and the height of the
    floor below [m]."""
    s, rods = thickness(subject), [shape for shape in drawn if isinstance(shape, Rod)]
    limbs, box = subject.robot.limb_geometry, subject.robot.workspace.bounding_box
    points = [limb.base + (limb.upper_arm or 0.1 * s) * limb.R_WL[:, 0] for limb in limbs]
    points += [point for rod in rods if not rod.body for point in (rod.start, rod.end)]
    corners = np.vstack([*points, *box])
    low, high = corners.min(axis=0) - 0.15 * s, corners.max(axis=0) + 0.15 * s
    return 0.5 * (low + high), float(np.linalg.norm(high - low)), low[2]


def _light(centre: Vector, size: float, away: tuple[float, ...]) -> dict[str, Vector]:
    place = centre + size * np.array(away)
    return {"pos": place, "dir": (centre - place) / np.linalg.norm(centre - place)}


def _camera(
    centre: Vector, size: float, way: tuple[float, ...], far: float
) -> dict[str, Float[np.ndarray, " _"]]:
    """A camera directed at the middle, with world z upwards; it looks along its own −z."""
    away = far * size * np.array(way) / np.linalg.norm(way)
    back = away / np.linalg.norm(away)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return {"pos": centre + away, "xyaxes": np.append(right, np.cross(back, right))}


def write_ensemble(samples: Samples, folder: str | Path) -> Path:
    """Write a new folder with one file per model, and an index of files and parameters.

    The folder appears with all its files, or not at all.

    Raises:
        DeltaidError: the folder exists or cannot be written, or MJCF cannot represent the robot.
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
