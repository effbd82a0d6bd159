"""Bodies of a description: the prior, and which of the ten inertia parameters are identified.

Priors are numbers or shapes (Sec. VIII A): cylinders, tubes and points.
"""

import re
from collections.abc import Collection
from typing import Annotated, Literal, get_args

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.robot.inertia import InertiaName, RigidBody
from deltaid.robot.measured import Measured
from deltaid.robot.part import (
    Axis,
    Coordinate,
    Length,
    Mass,
    NotNegative,
    Part,
    Point,
    Positive,
    Radius,
    Vector,
    require_one,
)


class HollowCylinder(Part):
    """A tube (or, with `inner_radius: 0`, a solid cylinder) along one axis of the link frame.

    About its own centre, with outer and inner radius R_o and R_i and length L, the moment along
    the axis is ½ m (R_o² + R_i²) and across it m (L² + 3 (R_o² + R_i²)) / 12.
    """

    shape: Literal["hollow_cylinder"] = Field(description="a tube, or a solid cylinder")
    axis: Axis = Field(description="axis of the link frame along the cylinder")
    length: Length = Field(description="m")
    outer_radius: Length = Field(description="m")
    inner_radius: Radius = Field(default=0.0, description="m")
    centre: Point = Field(description="centre of the cylinder in the link frame, m")
    mass: Mass | None = Field(default=None, description="kg; or give a density")
    density: Positive | None = Field(default=None, description="kg/m³; or give a mass")

    @model_validator(mode="after")
    def _check(self) -> "HollowCylinder":
        require_one(self, "mass", "density")
        if self.inner_radius >= self.outer_radius:
            raise ValueError("inner_radius must be smaller than outer_radius")
        return self

    def parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters about the link frame."""
        radii = self.outer_radius**2 + self.inner_radius**2
        area = np.pi * (self.outer_radius**2 - self.inner_radius**2)
        mass = self.mass or (self.density or 0.0) * area * self.length
        second_moments = np.full(3, mass * radii / 4)  # ∫x² dm across the axis
        second_moments["xyz".index(self.axis)] = mass * self.length**2 / 12
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


Entry = Literal["m", "mcx", "mcy", "mcz", "Sxx", "Syy", "Szz", "Sxy", "Syz", "Sxz"]

# Names of bodies in words.
_BODIES = {
    "U": "upper arm",
    "C": "carriage",
    "S": "strut",
    "P": "platform",
    "SB": "side bar",
    "MB": "middle bar",
    "MP": "main part",
    "R": "rod",
    "HP": "half platform",
    "TU": "upper telescope bar",
    "TL": "lower telescope bar",
    "EE": "end effector",
}
# Name of a body of one limb, where limbs are not identical: a letter and the limb's number.
NUMBERED = re.compile(r"([USC])(\d+)")


class InertiaTensor(Part):
    """Entries of the inertia tensor (5) about the link frame's origin, kg m²."""

    xx: NotNegative = Field(description="moment of inertia about x, kg m²")
    yy: NotNegative = Field(description="moment of inertia about y, kg m²")
    zz: NotNegative = Field(description="moment of inertia about z, kg m²")
    xy: Coordinate = Field(default=0.0, description="−∫ x y dm, kg m²")
    yz: Coordinate = Field(default=0.0, description="−∫ y z dm, kg m²")
    xz: Coordinate = Field(default=0.0, description="−∫ x z dm, kg m²")


class ExplicitInertia(Part):
    """A body given by its numbers: mass, first moment and inertia tensor about the link frame."""

    mass: Mass = Field(description="kg")
    first_moment: Vector = Field(description="mass times centre of mass in the link frame, kg m")
    inertia: InertiaTensor = Field(description="about the link frame's origin")

    def parameters(self) -> Float[np.ndarray, " 10"]:
        """The ten inertia parameters about the link frame."""
        return np.array([self.mass, *self.first_moment, *dict(self.inertia).values()], dtype=float)

    @classmethod
    def from_parameters(cls, p: Float[np.ndarray, " 10"]) -> "ExplicitInertia":
        """Body with these ten inertia parameters."""
        m, x, y, z, *inertia = (float(value) for value in p)
        tensor = InertiaTensor(**dict(zip(InertiaTensor.model_fields, inertia, strict=True)))
        return cls(mass=m, first_moment=(x, y, z), inertia=tensor)


Prior = ExplicitInertia | tuple[Shape, ...]


class Body(Part):
    """A body's prior and which of its ten parameters the identification may change.

    `free` names independent entries of the pseudo-inertia matrix: m, the first moments mcx, mcy,
    mcz, and the second moments Sxx … Sxz (Sxx = ∫x² dm, so Θ_zz = Sxx + Syy). They are the paper's
    α, t1–t3, d1–d3, s12, s23, s13 in that order. First moments and products that are not named are
    zero in the result (Sec. VI a–f); a mass or a second moment that is not named keeps its
    prior, because torques cannot see it, or grows just enough to keep the body consistent. An empty
    list is a body that is known, such as a tool with CAD data (Sec. VI f): all ten stay as given.
    """

    prior: Prior = Field(
        description="what is known before any recording: shapes, or numbers from CAD"
    )
    free: tuple[Entry, ...] = Field(
        default=get_args(Entry),
        description="entries that the identification may change; all ten by default; [] for a "
        "body that is known and keeps its prior",
        json_schema_extra={"uniqueItems": True},
    )
    spread: Positive | dict[InertiaName, Positive] | None = Field(
        default=None,
        description="standard deviation of the prior as a share of its values, in place of the "
        "fit's own: of all ten entries or by name (m, mcx, …, Ixx, …)",
    )
    measured: tuple[Measured, ...] = Field(
        default=(), description="what a scale, an edge or a pendulum said of it"
    )

    @model_validator(mode="after")
    def _check(self) -> "Body":
        if len(set(self.free)) != len(self.free):
            raise ValueError("free names an entry twice")
        if isinstance(self.prior, tuple) and not self.prior:
            raise ValueError("prior needs at least one shape")
        if reason := RigidBody(self.prior_parameters()).with_thickness().why_inconsistent:
            raise ValueError(f"the prior is not a physical body: {reason}")
        return self

    def prior_parameters(self) -> Float[np.ndarray, " 10"]:
        """Prior inertia parameters p_reg, before the reduction by `free`."""
        return _parameters(self.prior)

    def reduced_prior(self) -> Float[np.ndarray, " 10"]:
        """Prior with the first moments and products that `free` excludes set to zero.

        A body without thickness gets a small one (`RigidBody.with_thickness`).
        """
        return reduced_prior(self.prior, self.free)


# First moments and products: zero unless they are free.
ZERO_UNLESS_FREE = ("mcx", "mcy", "mcz", "Sxy", "Syz", "Sxz")


def reduced_prior(prior: Prior, free: Collection[str]) -> Float[np.ndarray, " 10"]:
    """`Body.reduced_prior` of a prior and its free entries."""
    body = RigidBody(_parameters(prior))
    if free:
        body = body.without([entry for entry in ZERO_UNLESS_FREE if entry not in free])
    return body.with_thickness().p


def _parameters(prior: Prior) -> Float[np.ndarray, " 10"]:
    if isinstance(prior, ExplicitInertia):
        return prior.parameters()
    return np.sum([shape.parameters() for shape in prior], axis=0)


def body_in_words(name: str) -> str:
    """Body in words: 'upper arm' for U, 'upper arm 2' for U2, else its name."""
    if numbered := NUMBERED.fullmatch(name):
        return f"{_BODIES[numbered[1]]} {numbered[2]}"
    return _BODIES.get(name, name)
