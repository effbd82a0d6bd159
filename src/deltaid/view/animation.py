"""A robot moving along its recorded or planned motion, in three dimensions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.limits import Box, Cylinder, Hemisphere
from deltaid.view import style
from deltaid.view.comparison import even_rows
from deltaid.view.drawing import members, outline, outline_points
from deltaid.view.page import Figure

# Frames of the player, seconds that they show, points of the whole path: what a page holds easily.
_FRAMES, _SECONDS, _PATH = 100, 4.0, 2000
# From slightly above, as far away as the axes' titles need.
CAMERA = {"eye": {"x": 1.6, "y": 1.15, "z": 0.45}, "center": {"z": -0.12}}
_SEEN = 60.0  # s of a recording that are looked at for a stretch worth seeing


# The platform point over time.
Path = Float[np.ndarray, "samples 3"]


@dataclass(frozen=True)
class ShownMotion:
    """Task coordinates over time, evenly spaced in time."""

    time: Float[np.ndarray, " samples"]
    z: Float[np.ndarray, "samples dof"]


def recorded_motion(kinematics: Kinematics, recording: PreparedRecording) -> ShownMotion:
    """The first minute of a recording."""
    time, z = [], []
    for window in recording.windows(kinematics):
        time.append(window.own.time)
        z.append(window.own.z)
        if time[-1][-1] - time[0][0] > _SEEN:
            break
    return ShownMotion(np.concatenate(time), np.concatenate(z))


def animation(kinematics: Kinematics, motion: ShownMotion, caption: str) -> Figure:
    """The robot along the stretch of a few seconds in which its platform travels farthest."""
    workspace, path = kinematics.robot.workspace, kinematics.robot.task.point(motion.z)
    seen = _liveliest(motion.time, path)
    count = min(_FRAMES, seen.stop - seen.start)
    chosen = np.linspace(seen.start, seen.stop - 1, count).astype(int)
    skeleton, time = Skeleton(kinematics.robot, kinematics.mechanism), motion.time[chosen]
    shapes = skeleton.evaluate(motion.z[chosen])
    lines = robot_lines(skeleton, shapes[0])
    dots = {"color": style.PRIOR, "width": 2, "dash": "dot"}
    still = [
        *([lines.pop("base")] if "base" in lines else []),
        workspace_line(workspace, {"color": style.PRIOR, "width": 1}).update(showlegend=False),
        still_line("path", path[even_rows(len(path), _PATH)], dots),
        still_line("path shown", path[seen][::5], {"color": style.SERIES[1], "width": 3}),
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
    # From which the page makes a player: times of the frames [s], and from one to the next [ms].
    pause = 1000 * float(time[-1] - time[0]) / max(count - 1, 1)
    figure.update_layout(meta={"times": time.tolist(), "pause": pause})
    fix_scene(figure, shapes.reshape(-1, 3), path, outline_points(workspace))
    return Figure(figure, caption)


def _liveliest(time: Float[np.ndarray, " samples"], path: Path) -> slice:
    """Samples of the stretch in which the platform point travels farthest."""
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    interval = (time[-1] - time[0]) / max(len(time) - 1, 1)
    length = min(len(time), int(_SECONDS / interval) + 1) if interval > 0 else 1
    start = int(np.argmax(travelled[length - 1 :] - travelled[: len(travelled) - length + 1]))
    return slice(start, start + length)


def workspace_line(workspace: Cylinder | Hemisphere | Box, line: dict[str, Any]) -> go.Scatter3d:
    """Circles and edges of a workspace."""
    return still_line("workspace", outline(workspace), line)


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
    """A robot in one pose: one line a body, by its name."""
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
    """Fixed ranges of equal scale around everything that is drawn; pixels kept free below."""
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
