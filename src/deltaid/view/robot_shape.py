"""How a robot is drawn: colours of its bodies, and the edges of its workspace."""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.robot.limits import Box, Cylinder, Hemisphere
from deltaid.view import style

_NUMBERED = re.compile(r"([USC])(\d+)")
_ONE = {"U": "upper arm", "C": "carriage", "S": "strut"}
_ANGLES = np.linspace(0.0, 2 * np.pi, 73)
_LIFTED = np.full((1, 3), np.nan)
# Radius of a part for each pixel of its width in figures, as a share of the robot's size.
_THICK = 0.0013
Line = Float[np.ndarray, "_ 3"]


@dataclass(frozen=True)
class DrawnBody:
    """What a body is called in a legend, its colour, and its width in pixels."""

    label: str
    color: str
    width: int

    def radius(self, size: float) -> float:
        """Radius of its parts for a robot of this size [m]."""
        return _THICK * size * self.width


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
    """Each body's member: those of a limb of its own by its number, foreign ones by their name."""
    return {body: _member(body, i) for i, body in enumerate(bodies)}


def _member(body: str, i: int) -> DrawnBody:
    if body in _KNOWN:
        return _KNOWN[body]
    if of_limb := _NUMBERED.fullmatch(body):
        like = _KNOWN[of_limb[1]]
        return DrawnBody(f"{_ONE[of_limb[1]]} {of_limb[2]}", like.color, like.width)
    return DrawnBody(body, style.SERIES[i % len(style.SERIES)], 5)


def outline(workspace: Cylinder | Hemisphere | Box) -> Line:
    """Circles and edges of a workspace in the world [m]."""
    if isinstance(workspace, Cylinder):
        lines = _cylinder(workspace)
    else:
        lines = _hemisphere(workspace) if isinstance(workspace, Hemisphere) else _box(workspace)
    return np.concatenate([part for line in lines for part in (line, _LIFTED)])


def outline_segments(workspace: Cylinder | Hemisphere | Box) -> Float[np.ndarray, "segments 2 3"]:
    """The same as pairs of ends."""
    edges = outline(workspace)
    pairs = np.stack([edges[:-1], edges[1:]], axis=1)
    return pairs[~np.isnan(pairs).any(axis=(1, 2))]


def outline_points(workspace: Cylinder | Hemisphere | Box) -> Line:
    """The same without gaps."""
    edges = outline(workspace)
    return edges[~np.isnan(edges[:, 0])]


def _circle(radius: float, height: float) -> Line:
    x, y = radius * np.cos(_ANGLES), radius * np.sin(_ANGLES)
    return np.column_stack([x, y, np.full_like(x, height)])


def _cylinder(workspace: Cylinder) -> list[Line]:
    low, high = (_circle(workspace.radius, height) for height in workspace.z)
    return [low, high, *(np.stack([low[k], high[k]]) for k in range(0, 72, 18))]


def _hemisphere(workspace: Hemisphere) -> list[Line]:
    half = _ANGLES[36:]  # π to 2 π: below
    across, down = workspace.radius * np.cos(half), workspace.radius * np.sin(half)
    nothing, height = np.zeros_like(half), workspace.top + down
    arcs = [np.column_stack([across, nothing, height]), np.column_stack([nothing, across, height])]
    return [_circle(workspace.radius, workspace.top), *arcs]


def _box(workspace: Box) -> list[Line]:
    x, y, z = workspace.bounds
    corners = np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]), (x[0], y[0])])
    low, high = (np.column_stack([corners, np.full(5, height)]) for height in z)
    return [low, high, *(np.stack([low[k], high[k]]) for k in range(4))]
