"""Where the platform point may go: a cylinder, a hemisphere (the paper's Fig. 2) or a box."""

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator

from deltaid.robot.part import Length, Part, Position

Range = tuple[Position, Position]


class Cylinder(Part):
    """A cylinder about world z."""

    shape: Literal["cylinder"] = Field(description="about world z")
    radius: Length = Field(description="m")
    z: Range = Field(description="lowest and highest platform point, m")

    @model_validator(mode="after")
    def _check(self) -> "Cylinder":
        _require_increasing("z", self.z)
        return self

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

    @model_validator(mode="after")
    def _check(self) -> "Box":
        for name in ("x", "y", "z"):
            if (bounds := getattr(self, name)) is not None:
                _require_increasing(name, bounds)
        return self

    @property
    def inner_box(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Centre and half extents: the box itself."""
        bounds = self.bounds
        return bounds.mean(axis=1), 0.5 * (bounds[:, 1] - bounds[:, 0])

    @property
    def bounding_box(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of a box around [m]."""
        return self.bounds.T

    def contains(self, points: Float[np.ndarray, "samples 3"]) -> Bool[np.ndarray, " samples"]:
        """Which platform points lie inside."""
        bounds = self.bounds
        return np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)

    @property
    def bounds(self) -> Float[np.ndarray, "3 2"]:
        """Lowest and highest coordinate; the point stays at 0 where it does not move."""
        return np.array([self.x or (0.0, 0.0), self.y or (0.0, 0.0), self.z or (0.0, 0.0)])


Workspace = Annotated[Cylinder | Hemisphere | Box, Field(discriminator="shape")]


def _require_increasing(name: str, bounds: Range) -> None:
    if bounds[0] >= bounds[1]:
        raise ValueError(f"{name} must be given as [lowest, highest]")
