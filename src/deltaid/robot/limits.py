"""Limits of a robot: its task coordinates, workspace and drive limits.

The task z consists of coordinates of the platform point r and the angle ψ of a tool. A Delta has
z = (x, y, z) or (x, y, z, ψ). A user-defined mechanism may have fewer: (x, z) if planar, (x) for a
sled, (ψ) for a turntable. The other coordinates of r are then 0.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Shaped
from pydantic import Field

from deltaid.robot.part import (
    AngleRange,
    Length,
    Part,
    Position,
    Positive,
    Range,
    Speed,
)

TaskName = Literal["x", "y", "z", "psi"]
NAMES: tuple[TaskName, ...] = ("x", "y", "z", "psi")
UNITS = {"x": "m", "y": "m", "z": "m", "psi": "rad"}


@dataclass(frozen=True)
class Task:
    """Coordinates of z in order: some of x, y and z, then ψ if the tool turns."""

    names: tuple[TaskName, ...]

    @property
    def axes(self) -> tuple[int, ...]:
        """World axes (0, 1, 2) along which the point moves; their coordinates come first in z."""
        return tuple(NAMES.index(name) for name in self.names if name != "psi")

    @property
    def turn(self) -> int | None:
        """Index of ψ in z; None if the robot does not turn its tool."""
        return self.names.index("psi") if "psi" in self.names else None

    @property
    def moves(self) -> slice:
        """Indices of the point's coordinates in z."""
        return slice(0, len(self.axes))

    def point(self, z: Float[np.ndarray, "*rows dof"]) -> Float[np.ndarray, "*rows 3"]:
        """Platform point r in the world frame [m]."""
        if self.axes == (0, 1, 2):
            return z[..., :3]
        r = np.zeros((*z.shape[:-1], 3))
        r[..., self.axes] = z[..., self.moves]
        return r

    def of_point(self, r: Shaped[np.ndarray, "*rows 3"]) -> Float[np.ndarray, "*rows moves"]:
        """Coordinates of a world point, or a world vector, that belong to z."""
        return r[..., self.axes]


class Cylinder(Part):
    """A cylinder about world z."""

    shape: Literal["cylinder"] = Field(description="about world z")
    radius: Length = Field(description="m")
    z: Range = Field(description="lowest and highest platform point, m")

    @property
    def inner_box(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Centre and half extents of a box inside."""
        side = self.radius / np.sqrt(2)
        centre, half = 0.5 * (self.z[0] + self.z[1]), 0.5 * (self.z[1] - self.z[0])
        return np.array([0.0, 0.0, centre]), np.array([side, side, half])

    @property
    def bounding_box(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of a box around [m]."""
        r = self.radius
        return np.array([[-r, -r, self.z[0]], [r, r, self.z[1]]])

    def contains(self, points: Float[np.ndarray, "samples 3"]) -> Bool[np.ndarray, " samples"]:
        """Which platform points lie inside."""
        inside = np.hypot(points[:, 0], points[:, 1]) <= self.radius
        return inside & (points[:, 2] >= self.z[0]) & (points[:, 2] <= self.z[1])


class Hemisphere(Part):
    """The lower half of a ball whose centre lies on world z at height `top`."""

    shape: Literal["hemisphere"] = Field(description="the lower half of a ball")
    radius: Length = Field(description="m")
    top: Position = Field(description="height of the flat side, m")

    @property
    def inner_box(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Centre and half extents of a box inside."""
        half = self.radius / np.sqrt(3)
        return np.array([0.0, 0.0, self.top - 0.5 * half]), np.array([half, half, 0.5 * half])

    @property
    def bounding_box(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of a box around [m]."""
        r = self.radius
        return np.array([[-r, -r, self.top - r], [r, r, self.top]])

    def contains(self, points: Float[np.ndarray, "samples 3"]) -> Bool[np.ndarray, " samples"]:
        """Which platform points lie inside."""
        centred = points - np.array([0.0, 0.0, self.top])
        return (np.linalg.norm(centred, axis=1) <= self.radius) & (centred[:, 2] <= 0)


class Box(Part):
    """A box along the world's axes; a mechanism of the user's own may not move along some."""

    shape: Literal["box"] = Field(description="along the world's axes")
    x: Range | None = Field(default=None, description="m; omitted where the robot does not move")
    y: Range | None = Field(default=None, description="m; the same")
    z: Range | None = Field(default=None, description="m; the same")

    @property
    def inner_box(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Centre and half extents: the box itself."""
        low, high = self.bounding_box
        return 0.5 * (low + high), 0.5 * (high - low)

    @property
    def bounding_box(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner [m]; the point stays at 0 where it does not move."""
        return np.array([axis or (0.0, 0.0) for axis in (self.x, self.y, self.z)]).T

    def contains(self, points: Float[np.ndarray, "samples 3"]) -> Bool[np.ndarray, " samples"]:
        """Which platform points lie inside."""
        low, high = self.bounding_box
        return np.all((points >= low) & (points <= high), axis=1)


Workspace = Annotated[Cylinder | Hemisphere | Box, Field(discriminator="shape")]


class DriveLimits(Part):
    """What one drive can do: a motor in degrees and newton metres, a rail in metres and newtons."""

    angle_deg: AngleRange | None = Field(
        default=None, description="lowest and highest angle of a rotary drive, degrees"
    )
    speed_deg_s: Positive | None = Field(
        default=None, description="largest speed of a rotary drive, degrees/s"
    )
    acceleration_deg_s2: Positive | None = Field(
        default=None, description="largest acceleration of a rotary drive, degrees/s²"
    )
    torque: Positive | None = Field(
        default=None, description="largest torque of a rotary drive, N m"
    )
    position: Range | None = Field(
        default=None, description="lowest and highest position of a linear drive, m"
    )
    speed: Speed | None = Field(default=None, description="largest speed of a linear drive, m/s")
    acceleration: Positive | None = Field(
        default=None, description="largest acceleration of a linear drive, m/s²"
    )
    force: Positive | None = Field(default=None, description="largest force of a linear drive, N")

    def foreign(self, *, linear: bool) -> list[str]:
        """Given keys that belong to the other kind of drive."""
        names = _ROTARY if linear else _LINEAR
        return [name for name in names if getattr(self, name) is not None]

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest drive coordinate [rad or m]."""
        if self.angle_deg is not None:
            low, high = np.deg2rad(self.angle_deg)
            return float(low), float(high)
        return self.position

    @property
    def top_speed(self) -> float | None:
        """Largest speed [rad/s or m/s]."""
        return float(np.deg2rad(self.speed_deg_s)) if self.speed_deg_s else self.speed

    @property
    def top_acceleration(self) -> float | None:
        """Largest acceleration [rad/s² or m/s²]."""
        in_degrees = self.acceleration_deg_s2
        return float(np.deg2rad(in_degrees)) if in_degrees else self.acceleration

    @property
    def effort(self) -> float | None:
        """Largest torque or force [N m or N]."""
        return self.torque or self.force


_ROTARY = ("angle_deg", "speed_deg_s", "acceleration_deg_s2", "torque")
_LINEAR = ("position", "speed", "acceleration", "force")
