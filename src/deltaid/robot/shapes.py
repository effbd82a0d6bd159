"""Shapes whose inertia parameters serve as priors (Sec. VIII A): cylinders, tubes and points."""

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.robot.inertia import RigidBody
from deltaid.robot.part import Part
from deltaid.robot.quantities import Length, Mass, Point, Positive, Radius

_AXES = {"x": 0, "y": 1, "z": 2}


class HollowCylinder(Part):
    """A tube (or, with `inner_radius: 0`, a solid cylinder) along one axis of the link frame.

    About its own centre, with outer and inner radius R_o and R_i and length L, the moment along
    the axis is ½ m (R_o² + R_i²) and across it m (L² + 3 (R_o² + R_i²)) / 12.
    """

    shape: Literal["hollow_cylinder"] = Field(description="a tube, or a solid cylinder")
    axis: Literal["x", "y", "z"] = Field(description="axis of the link frame along the cylinder")
    length: Length = Field(description="m")
    outer_radius: Length = Field(description="m")
    inner_radius: Radius = Field(default=0.0, description="m")
    centre: Point = Field(description="centre of the cylinder in the link frame, m")
    mass: Mass | None = Field(default=None, description="kg; or give a density")
    density: Positive | None = Field(default=None, description="kg/m³; or give a mass")

    @model_validator(mode="after")
    def _check(self) -> "HollowCylinder":
        if (self.mass is None) == (self.density is None):
            raise ValueError("give either mass or density")
        if self.inner_radius >= self.outer_radius:
            raise ValueError("inner_radius must be smaller than outer_radius")
        return self

    def parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters about the link frame."""
        radii = self.outer_radius**2 + self.inner_radius**2
        mass = self.mass
        if mass is None:
            assert self.density is not None
            area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
            mass = self.density * area * self.length
        second_moments = np.full(3, mass * radii / 4)  # ∫x² dm across the axis
        second_moments[_AXES[self.axis]] = mass * self.length**2 / 12
        return RigidBody.centred(mass, np.array(self.centre), np.diag(second_moments)).p


class PointMass(Part):
    """A mass concentrated at one point."""

    shape: Literal["point_mass"] = Field(description="a mass at one point")
    mass: Mass = Field(description="kg")
    centre: Point = Field(description="position in the link frame, m")

    def parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters about the link frame."""
        return RigidBody.point(self.mass, self.centre).p


Shape = Annotated[HollowCylinder | PointMass, Field(discriminator="shape")]
