"""The edges of a workspace as one line, with gaps (NaN) where the pen is lifted."""

import numpy as np
from jaxtyping import Float

from deltaid.robot.workspace import Box, Cylinder, Hemisphere

_ANGLES = np.linspace(0.0, 2 * np.pi, 73)
_LIFTED = np.full((1, 3), np.nan)

Line = Float[np.ndarray, "_ 3"]


def outline(workspace: Cylinder | Hemisphere | Box) -> Line:
    """Circles and edges of a workspace in the world [m]."""
    if isinstance(workspace, Cylinder):
        return _joined(_cylinder(workspace))
    if isinstance(workspace, Hemisphere):
        return _joined(_hemisphere(workspace))
    return _joined(_box(workspace))


def _joined(lines: list[Line]) -> Line:
    return np.concatenate([part for line in lines for part in (line, _LIFTED)])


def _circle(radius: float, height: float) -> Line:
    flat = radius * np.cos(_ANGLES), radius * np.sin(_ANGLES), np.full_like(_ANGLES, height)
    return np.column_stack(flat)


def _cylinder(workspace: Cylinder) -> list[Line]:
    low, high = (_circle(workspace.radius, height) for height in workspace.z)
    sides = [np.stack([low[k], high[k]]) for k in range(0, 72, 18)]
    return [low, high, *sides]


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
