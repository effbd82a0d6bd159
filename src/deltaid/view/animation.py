"""A robot in three dimensions: animated along a recorded or planned motion, and its bodies as
equivalent ellipsoids of uniform density."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from deltaid.mechanism.kinematics import BodyPoses, Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.record import IdentifiedModel
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.inertia import RigidBody
from deltaid.view import style
from deltaid.view.comparison import even_rows
from deltaid.view.drawing import members, outline, outline_points
from deltaid.view.numbers import number
from deltaid.view.page import Figure, Section, Table, Text

# Frames of the animation, its duration [s], and points of the whole path.
_FRAMES, _SECONDS, _PATH = 100, 4.0, 2000
# Camera slightly above the robot, far enough for the titles of the axes.
CAMERA = {"eye": {"x": 1.6, "y": 1.15, "z": 0.45}, "center": {"z": -0.12}}
_SEARCHED = 60.0  # duration of the searched part of a recording [s]


def recorded_motion(
    kinematics: Kinematics, recording: PreparedRecording
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, "samples dof"]]:
    """Times and task coordinates of the first minute of a recording."""
    time, z = [], []
    for window in recording.windows(kinematics):
        time.append(window.inner.time)
        z.append(window.inner.z)
        if time[-1][-1] - time[0][0] > _SEARCHED:
            break
    return np.concatenate(time), np.concatenate(z)


def animation(
    kinematics: Kinematics,
    time: Float[np.ndarray, " samples"],
    z: Float[np.ndarray, "samples dof"],
    caption: str,
) -> Figure:
    """The robot along the stretch of a few seconds in which its platform travels farthest.

    Args:
        time, z: of the motion, at a constant rate.
    """
    workspace, path = kinematics.robot.workspace, kinematics.robot.task.point(z)
    stretch = _liveliest(time, path)
    count = min(_FRAMES, stretch.stop - stretch.start)
    chosen = np.linspace(stretch.start, stretch.stop - 1, count).astype(int)
    skeleton, shown = Skeleton(kinematics.robot, kinematics.mechanism), time[chosen]
    shapes = skeleton.evaluate(z[chosen])
    lines = robot_lines(skeleton, shapes[0])
    thin, dots = (
        {"color": style.PRIOR, "width": 1},
        {"color": style.PRIOR, "width": 2, "dash": "dot"},
    )
    still = [
        *([lines.pop("base")] if "base" in lines else []),
        still_line("workspace", outline(workspace), thin).update(showlegend=False),
        still_line("path", path[even_rows(len(path), _PATH)], dots),
        still_line("path shown", path[stretch][::5], {"color": style.SERIES[1], "width": 3}),
    ]
    frames = [
        go.Frame(
            name=str(k),
            traces=list(range(len(still), len(still) + len(lines))),
            data=[go.Scatter3d(_body_line(skeleton, shape, name)) for name in lines],
        )
        for k, shape in zip(chosen, shapes, strict=True)
    ]
    figure = go.Figure([*still, *lines.values()], frames=frames)
    # The page's player needs the times of the frames [s] and the time between two of them [ms].
    pause = 1000 * float(shown[-1] - shown[0]) / max(count - 1, 1)
    figure.update_layout(meta={"times": shown.tolist(), "pause": pause})
    fix_scene(figure, shapes.reshape(-1, 3), path, outline_points(workspace))
    return Figure(figure, caption)


def _liveliest(time: Float[np.ndarray, " samples"], path: Float[np.ndarray, "samples 3"]) -> slice:
    """Samples of the stretch in which the platform point travels farthest."""
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    interval = (time[-1] - time[0]) / max(len(time) - 1, 1)
    length = min(len(time), int(_SECONDS / interval) + 1) if interval > 0 else 1
    start = int(np.argmax(travelled[length - 1 :] - travelled[: len(travelled) - length + 1]))
    return slice(start, start + length)


def still_line(
    name: str, points: Float[np.ndarray, "points 3"], line: dict[str, Any]
) -> go.Scatter3d:
    """A line through points in the world, with gaps where they are NaN."""
    return go.Scatter3d(
        dict(zip("xyz", points.astype(np.float32).T, strict=True)),
        name=name,
        mode="lines",
        line=line,
        hoverinfo="skip",
    )


def with_gaps(ends: Float[np.ndarray, "segments 2 3"]) -> Float[np.ndarray, "points 3"]:
    """Points of a line through all segments, with gaps (NaN) between them."""
    return np.concatenate([ends, np.full((len(ends), 1, 3), np.nan)], axis=1).reshape(-1, 3)


def _body_line(
    skeleton: Skeleton, shape: Float[np.ndarray, "segments 2 3"], body: str
) -> dict[str, Float[np.ndarray, " points"]]:
    own = [i for i, segment in enumerate(skeleton.segments) if segment.body == body]
    return dict(zip("xyz", with_gaps(shape[own]).T.astype(np.float32), strict=True))


def robot_lines(
    skeleton: Skeleton, shape: Float[np.ndarray, "segments 2 3"]
) -> dict[str, go.Scatter3d]:
    """A robot in one pose: one line for each body, by its name."""
    return {
        body: go.Scatter3d(
            _body_line(skeleton, shape, body),
            name=style.label(member.label),
            mode="lines",
            line={"color": member.color, "width": member.width},
            hoverinfo="skip",
        )
        for body, member in members(skeleton.bodies).items()
    }


def fix_scene(
    figure: go.Figure, *drawn: Float[np.ndarray, "_ 3"], height: int = 640, below: int = 20
) -> None:
    """Fix ranges of equal scale around everything that is drawn; `below` is free space [px]."""
    points = np.concatenate(drawn)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * float((high - low).max())
    axes = {
        f"{name}axis": {"range": [low[i] - margin, high[i] + margin], "title": f"{name} [m]"}
        for i, name in enumerate("xyz")
    }
    figure.update_layout(
        height=height,
        margin={"l": 0, "r": 0, "t": 60, "b": below},
        scene={**axes, "aspectmode": "data", "camera": CAMERA},
        uirevision="kept",
    )


_POINTS = 240  # number on a sphere's surface
_GOLDEN = np.pi * (3 - np.sqrt(5))


def body_section(model: IdentifiedModel, kinematics: Kinematics) -> Section:
    """Mass and moments of all bodies, prior and fitted, and their consistency."""
    home = model.robot.within(0.0)[0][None]
    lines = with_gaps(Skeleton(model.robot, kinematics.mechanism).evaluate(home)[0])
    axes = {f"{name}axis": {"title": f"{name} [m]"} for name in "xyz"}
    picture = Figure(
        go.Figure(
            [
                still_line("robot", lines, {"color": style.SERIES[5], "width": 2}),
                _outlines(model, kinematics.poses(home)),
                _mesh(model, kinematics.poses(home)),
            ],
            {
                "height": 600,
                "margin": {"l": 0, "r": 0, "t": 50, "b": 0},
                "scene": axes | {"aspectmode": "data", "camera": CAMERA},
            },
        ),
        "Equivalent ellipsoids of all bodies in the middle of the workspace. Click on the legend "
        "to hide the prior or the identified bodies; of two equal struts in one pair one is drawn.",
    )
    eigenvalues = Table(
        ("body", "smallest", "second", "third", "largest", "consistent"),
        tuple(
            (body.body, *map(number, body.eigenvalues), "yes" if body.eigenvalues[0] > 0 else "no")
            for body in model.consistency
        ),
        "Eigenvalues of each body's pseudo-inertia matrix. A body exists physically if and only "
        "if all four are positive.",
    )
    about = Text(
        "Each body is drawn as the ellipsoid of uniform density that has its mass, centre of mass "
        "and moments of inertia: in orange the identified body, in grey outlines the prior. "
        "Entries that the data does not determine come from the prior, so the place and shape of a "
        "single body are less certain than what the drives feel of it."
    )
    return Section(
        "Bodies",
        (about, picture, _masses(model), eigenvalues),
        "masses, centres of mass and shapes, prior and identified",
    )


def ellipsoid(
    p: Float[np.ndarray, " 10"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Centre c and matrix A of the ellipsoid {c + A u, |u| ≤ 1} with the mass and moments of p.

    With Σ_C = Σ − m c cᵀ = Σ λ_i v_i v_iᵀ about the centre of mass, a uniform ellipsoid of half
    axes a_i has λ_i = m a_i² / 5, so a_i = √(5 λ_i / m), and A = [a_1 v_1, a_2 v_2, a_3 v_3].
    """
    body = RigidBody(p)
    values, vectors = np.linalg.eigh(body.second_moments)
    return body.com, vectors * np.sqrt(5 * np.maximum(values, 0) / body.mass)


def _mesh(model: IdentifiedModel, poses: Sequence[BodyPoses]) -> go.Mesh3d:
    # Points evenly spread over the unit sphere, along a spiral.
    k = np.arange(_POINTS)
    height = 1 - (2 * k + 1) / _POINTS
    r = np.sqrt(1 - height**2)
    ball = np.column_stack([r * np.cos(_GOLDEN * k), r * np.sin(_GOLDEN * k), height])
    faces = outward_faces(ball)
    points = [placed(model, pose, model.p, ball).astype(np.float32) for pose in poses]
    masses = {pose.name: model.p[model.layout.body(pose.name)][0] for pose in poses}
    indices = np.concatenate([faces + k * _POINTS for k in range(len(poses))]).astype(np.int32).T
    return go.Mesh3d(
        dict(zip("xyzijk", (*np.concatenate(points).T, *indices), strict=True)),
        name="identified",
        color=style.IDENTIFIED,
        opacity=0.7,
        showlegend=True,
        text=[
            f"{style.label(pose.name)}: {masses[pose.name]:.4g} kg"
            for pose in poses
            for _ in range(_POINTS)
        ],
        hoverinfo="text",
        lighting={"ambient": 0.65, "diffuse": 0.5, "specular": 0.1, "roughness": 0.9},
    )


def _outlines(model: IdentifiedModel, poses: Sequence[BodyPoses]) -> go.Scatter3d:
    prior, angle = np.array([p.prior for p in model.parameters]), np.linspace(0, 2 * np.pi, 61)
    flat = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    flat = np.append(flat, np.full((1, 3), np.nan), axis=0)
    circles = np.concatenate([np.roll(flat, k, axis=1) for k in range(3)])
    lines = [placed(model, pose, prior, circles) for pose in poses]
    return still_line("prior", np.concatenate(lines), {"color": style.PRIOR, "width": 3})


def placed(
    model: IdentifiedModel,
    pose: BodyPoses,
    p: Float[np.ndarray, " parameters"],
    points: Float[np.ndarray, "points 3"],
) -> Float[np.ndarray, "points 3"]:
    """Points of a body's ellipsoid in the world, from points of the unit sphere."""
    centre, A = ellipsoid(p[model.layout.body(pose.name)])
    return pose.r_WB[0] + (centre + points @ A.T) @ pose.R_WB[0].T


def outward_faces(corners: Float[np.ndarray, "points 3"]) -> Int[np.ndarray, "faces 3"]:
    """Triangles of a convex surface about the origin, all oriented outwards, as lighting
    requires."""
    faces = ConvexHull(corners).simplices
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return faces


def _masses(model: IdentifiedModel) -> Table:
    by_name = {parameter.name: parameter for parameter in model.parameters}
    rows = []
    for body in model.layout.bodies:
        mass, (centre, A) = by_name[f"{body}.m"], ellipsoid(model.p[model.layout.body(body)])
        half = " × ".join(number(1000 * value, 3) for value in np.linalg.norm(A, axis=0)[::-1])
        place = ", ".join(f"{1000 * value:.1f}" for value in centre)
        prior, value = number(mass.prior), number(mass.value)
        rows.append((body, prior, value, mass.determined_by, place, half))
    return Table(
        ("body", "prior mass [kg]", "mass [kg]", "mass from", "centre of mass [mm]",
         "half axes of the ellipsoid [mm]"),
        tuple(rows),
        "Centre of mass in the body's link frame, and half axes of its equivalent ellipsoid, "
        "identified.",
    )  # fmt: skip
