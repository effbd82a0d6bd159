"""Straight parts of a robot as cylinders with ends, for a renderer that draws many of one mesh."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

# Sides of a cylinder, enough to look round.
_SIDES = 16


@dataclass(frozen=True)
class Mesh:
    """Corners, and triangles by the numbers of their corners, seen from outside anticlockwise."""

    corners: Float[np.ndarray, "corners 3"]
    triangles: Int[np.ndarray, "triangles 3"]


@dataclass(frozen=True)
class Placement:
    """Where copies of a mesh are: centres, orientations (w, x, y, z), scales along own axes."""

    positions: Float[np.ndarray, "n 3"]
    wxyz: Float[np.ndarray, "n 4"]
    scales: Float[np.ndarray, "n 3"]


def cylinder() -> Mesh:
    """A closed cylinder of radius 1 and length 1 about its z axis, its middle at the origin."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)])
    up = np.array([0.0, 0.0, 0.5])
    corners = np.concatenate([ring - up, ring + up, [-up, up]])
    low, high = np.arange(_SIDES), np.arange(_SIDES) + _SIDES
    low_next, high_next = np.roll(low, -1), np.roll(high, -1)
    bottom, top = np.full(_SIDES, 2 * _SIDES), np.full(_SIDES, 2 * _SIDES + 1)
    faces = [(low, low_next, high_next), (low, high_next, high)]
    faces += [(bottom, low_next, low), (top, high, high_next)]
    return Mesh(corners, np.concatenate([np.column_stack(face) for face in faces]))


def along(segments: Float[np.ndarray, "n 2 3"], radius: float) -> Placement:
    """Cylinders between the two ends of each segment."""
    way = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(way, axis=1)
    # A segment without length has no direction; any will do.
    unit = np.where(length[:, None] > 0, way, [0.0, 0.0, 1.0])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    thick = np.full(len(segments), radius)
    return Placement(
        positions=segments.mean(axis=1),
        wxyz=_turn_from_z(unit),
        scales=np.column_stack([thick, thick, np.maximum(length, 1e-9)]),
    )


def _turn_from_z(unit: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """The shortest rotations that take z to some directions."""
    axis = np.cross([0.0, 0.0, 1.0], unit)
    sine, cosine = np.linalg.norm(axis, axis=1), unit[:, 2]
    # Straight down any axis across z does.
    axis = np.where(sine[:, None] > 1e-12, axis, [1.0, 0.0, 0.0])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, cosine)
    return Rotation.from_rotvec(angle[:, None] * axis).as_quat()[:, [3, 0, 1, 2]]
