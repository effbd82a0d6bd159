"""Drawing of a robot: a picture with named bodies, colours and edges of the workspace."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.robot.body import NUMBERED, body_in_words
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Box, Cylinder, Hemisphere
from deltaid.view import style
from deltaid.view.html import environment
from deltaid.view.page import HEIGHT, Drawing

# Largest width and height of the robot, width of the names at either side, their least distance,
# and free height above the robot [px].
_WIDE, _HIGH, _NAMES, _LINE, _TOP = 320.0, 330.0, 132.0, 30.0, 16.0
# Direction of view, slightly from above.
_EYE = np.array([1.6, 1.15, 0.75]) / np.linalg.norm([1.6, 1.15, 0.75])


@dataclass(frozen=True)
class _Label:
    body: str
    at: Float[np.ndarray, " 2"]
    left: bool


def drawing(robot: RobotDescription, kinematics: Kinematics) -> Drawing:
    """A robot in the middle of its workspace, seen from slightly above."""
    skeleton = Skeleton(robot, kinematics.mechanism)
    bodies, drawn = [segment.body for segment in skeleton.segments], members(skeleton.bodies)
    flat, depth = _projected(skeleton.evaluate(robot.within(0.0)[0][None])[0])
    sides = _labels(bodies, flat)
    height = max(float(flat[..., 1].max()) + _TOP, _TOP + max(*map(len, sides), 1) * _LINE)
    heights = [y for side in sides for y in _spread([label.at[1] for label in side], height)]
    shown = [body for body in skeleton.bodies if body != "base"]
    svg = (
        environment()
        .get_template("drawing.svg.jinja")
        .render(
            width=float(flat[..., 0].max()) + _NAMES,
            height=height,
            room=_NAMES,
            names=", ".join(f"{body} {body_in_words(body)}" for body in shown),
            lines=[(flat[i].ravel(), drawn[bodies[i]]) for i in np.argsort(-depth)],
            labels=list(zip([label for side in sides for label in side], heights, strict=True)),
        )
    )
    return Drawing(
        Markup(svg),
        tuple((name, body_in_words(name)) for name in dict.fromkeys([*shown, *robot.body_names])),
    )


def _projected(
    points: Float[np.ndarray, "segments 2 3"],
) -> tuple[Float[np.ndarray, "segments 2 2"], Float[np.ndarray, " segments"]]:
    """Ends of all segments in the picture [px], and their distance from the viewer."""
    right = np.cross([0.0, 0.0, 1.0], _EYE)
    right /= np.linalg.norm(right)
    flat = np.stack([points @ right, -points @ np.cross(_EYE, right)], axis=-1)
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    scale = np.min(np.array([_WIDE, _HIGH]) / np.maximum(high - low, 1e-9))
    return scale * (flat - low) + np.array([_NAMES, _TOP]), -np.mean(points @ _EYE, axis=1)


def _labels(
    bodies: Sequence[str], flat: Float[np.ndarray, "segments 2 2"]
) -> tuple[list[_Label], list[_Label]]:
    """One name per body, beside its longest parts and outside of the robot, on alternating sides,
    each sorted from the top."""
    sides = list[_Label](), list[_Label]()
    for body in dict.fromkeys(bodies):
        own = flat[np.array(bodies) == body]
        lengths = np.linalg.norm(own[:, 1] - own[:, 0], axis=1)
        middles = own.mean(axis=1)[lengths >= 0.5 * lengths.max()]
        left = len(sides[0]) <= len(sides[1])
        outermost = np.argmin(middles[:, 0]) if left else np.argmax(middles[:, 0])
        sides[0 if left else 1].append(_Label(body, middles[outermost], left))
    for side in sides:
        side.sort(key=lambda label: label.at[1])
    return sides


def _spread(wanted: list[float], height: float) -> list[float]:
    """Heights closest to the wanted ones that stay apart and within the picture, in order."""
    placed, low = list[float](), height - _LINE + _TOP
    for y in wanted:
        placed.append(max(y, placed[-1] + _LINE if placed else _TOP))
    for i in reversed(range(len(placed))):
        placed[i] = min(placed[i], low)
        low = placed[i] - _LINE
    return placed


_ANGLES = np.linspace(0.0, 2 * np.pi, 73)
_LIFTED = np.full((1, 3), np.nan)
Line = Float[np.ndarray, "_ 3"]


@dataclass(frozen=True)
class DrawnBody:
    """Name of a body in a legend, its colour, and its line width in pixels."""

    label: str
    color: str
    width: int

    def radius(self, size: float) -> float:
        """Radius of its parts [m] that matches its line width in a figure of a robot of this
        size."""
        return 0.5 * self.width * size / HEIGHT


_KNOWN = {
    "base": DrawnBody("base", style.PRIOR, 5),
    "U": DrawnBody("upper arms", style.SERIES[0], 8),
    "C": DrawnBody("carriages", style.SERIES[0], 8),
    "S": DrawnBody("struts", style.SERIES[5], 3),
    "P": DrawnBody("platform", style.SERIES[3], 6),
    "SB": DrawnBody("side bars", style.SERIES[3], 6),
    "MB": DrawnBody("middle bar", style.SERIES[2], 6),
    "MP": DrawnBody("main parts", style.SERIES[3], 6),
    "R": DrawnBody("rods", style.SERIES[2], 6),
    "HP": DrawnBody("half platforms", style.SERIES[3], 6),
    "TU": DrawnBody("upper bar", style.SERIES[2], 5),
    "TL": DrawnBody("lower bar", style.SERIES[4], 5),
    "EE": DrawnBody("end effector", style.SERIES[1], 5),
}


def members(bodies: tuple[str, ...]) -> dict[str, DrawnBody]:
    """Style of each body: numbered bodies of limbs by their kind, others by their name."""
    drawn = dict[str, DrawnBody]()
    for i, body in enumerate(bodies):
        own = DrawnBody(body, style.SERIES[i % len(style.SERIES)], 5)
        if numbered := NUMBERED.fullmatch(body):
            own = replace(_KNOWN[numbered[1]], label=body_in_words(body))
        drawn[body] = _KNOWN.get(body, own)
    return drawn


def outline(workspace: Cylinder | Hemisphere | Box) -> Line:
    """Circles and edges of a workspace in the world [m], separated by NaN."""
    match workspace:
        case Hemisphere(radius=radius, top=top):
            half = _ANGLES[36:]  # from π to 2 π: below
            across, nothing, height = np.cos(half), 0 * half, top + radius * np.sin(half)
            arcs = [(radius * across, nothing, height), (nothing, radius * across, height)]
            lines = [_circle(radius, top), *map(np.column_stack, arcs)]
        case Cylinder():
            low, high = (_circle(workspace.radius, height) for height in workspace.z)
            lines = [low, high, *(np.stack([low[k], high[k]]) for k in range(0, 72, 18))]
        case _:
            (x0, x1), (y0, y1), z = workspace.bounding_box.T
            corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
            low, high = (np.column_stack([corners, np.full(5, height)]) for height in z)
            lines = [low, high, *(np.stack([low[k], high[k]]) for k in range(4))]
    return np.concatenate([part for line in lines for part in (line, _LIFTED)])


def outline_segments(workspace: Cylinder | Hemisphere | Box) -> Float[np.ndarray, "segments 2 3"]:
    """The outline as segments between two ends."""
    edges = outline(workspace)
    pairs = np.stack([edges[:-1], edges[1:]], axis=1)
    return pairs[~np.isnan(pairs).any(axis=(1, 2))]


def outline_points(workspace: Cylinder | Hemisphere | Box) -> Line:
    """Points of the outline, without gaps."""
    edges = outline(workspace)
    return edges[~np.isnan(edges[:, 0])]


def _circle(radius: float, height: float) -> Line:
    x, y = radius * np.cos(_ANGLES), radius * np.sin(_ANGLES)
    return np.column_stack([x, y, np.full_like(x, height)])


@dataclass(frozen=True)
class Placement:
    """Placement of copies of a mesh: centres, orientations (w, x, y, z), scales along their own
    axes."""

    positions: Float[np.ndarray, "n 3"]
    wxyz: Float[np.ndarray, "n 4"]
    scales: Float[np.ndarray, "n 3"]


def along(segments: Float[np.ndarray, "n 2 3"], radius: float) -> Placement:
    """Cylinders between the two ends of each segment."""
    way = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(way, axis=1)
    # A segment of length zero may have any direction.
    unit = np.where(length[:, None] > 0, way, [0.0, 0.0, 1.0])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    # Shortest rotations of z to the direction; to straight down, about any horizontal axis.
    wxyz = np.column_stack([1 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))])
    wxyz[1 + unit[:, 2] < 1e-12] = 0.0, 1.0, 0.0, 0.0
    thick = np.full(len(segments), radius)
    return Placement(
        positions=segments.mean(axis=1),
        wxyz=wxyz / np.linalg.norm(wxyz, axis=1, keepdims=True),
        scales=np.column_stack([thick, thick, np.maximum(length, 1e-9)]),
    )
