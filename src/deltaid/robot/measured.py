"""Values of bodies measured by other means than a recording: a scale, an edge, a pendulum.

Each value is linear in the ten parameters of its bodies and adds a row to the fit.
"""

from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from deltaid.robot.part import (
    Axis,
    Coordinate,
    Mass,
    Part,
    Point,
    Position,
    Positive,
    Vector,
    require_one,
)

Count = Annotated[int, Field(ge=1, le=1000)]

MeasuredQuantity = Literal["mass", "first_moment", "centre", "inertia"]
_QUANTITIES: tuple[MeasuredQuantity, ...] = get_args(MeasuredQuantity)


def require_axis(quantity: str, axis: str | Vector | None, choices: str) -> None:
    """Refuse an axis with a mass, a missing axis with other quantities, and a zero vector.

    Raises:
        ValueError: names the fault.
    """
    if quantity == "mass" and axis is not None:
        raise ValueError("a mass has no axis; leave it out")
    if quantity != "mass" and axis is None:
        raise ValueError(f"{quantity} needs its axis: {choices}")
    if not isinstance(axis, str) and axis is not None and not any(axis):
        raise ValueError("axis has no direction")


class Measured(Part):
    """One measured value of a body, in its link frame, with its standard deviation.

    One of `mass` (a scale), `first_moment` (the force on an edge times its distance), `centre` (of
    mass: balanced on an edge) and `inertia` (a pendulum's) is given.
    """

    mass: Mass | None = Field(default=None, description="kg")
    first_moment: Coordinate | None = Field(
        default=None, description="mass times centre of mass along `axis`, kg m"
    )
    centre: Position | None = Field(default=None, description="centre of mass along `axis`, m")
    inertia: Positive | None = Field(
        default=None,
        description="moment of inertia about the line through `about` along `axis`, kg m²",
    )
    std: Positive = Field(description="standard deviation of the value, in its unit")
    axis: Axis | Vector | None = Field(
        default=None, description="x, y, z or a direction; needed by all but mass"
    )
    about: Point = Field(
        default=(0.0, 0.0, 0.0), description="a point of the axis that inertia is about, m"
    )

    @property
    def quantity(self) -> MeasuredQuantity:
        """Name of the measured quantity."""
        return next(key for key in _QUANTITIES if getattr(self, key) is not None)

    @property
    def value(self) -> float:
        """The measured value [kg, kg m, m, kg m²]."""
        return float(getattr(self, self.quantity))

    @model_validator(mode="after")
    def _check(self) -> "Measured":
        quantity = require_one(self, *_QUANTITIES)
        require_axis(quantity, self.axis, "x, y, z or a direction")
        if quantity != "inertia" and any(self.about):
            raise ValueError("about is for inertia alone")
        return self


class Placed(Part):
    """A body among those that were measured together, in axes of the measurement."""

    body: str = Field(description="its name, as in bodies")
    count: Count = Field(default=1, description="how many of it")
    at: Point = Field(default=(0.0, 0.0, 0.0), description="where its link frame was, m")
    turned_deg: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="roll, pitch, yaw of its link frame, degrees: Rz(yaw) Ry(pitch) Rx(roll)",
    )


class MeasuredTogether(Measured):
    """One measured value of several bodies together, such as an arm with its struts."""

    of: str | dict[str, Count] | tuple[Placed, ...] = Field(
        description="a body; bodies and how many of each; or where each was, which counts for all "
        "but mass"
    )

    @property
    def placed(self) -> tuple[Placed, ...]:
        """Measured bodies and their poses."""
        return placed_bodies(self.of)


def placed_bodies(bodies: str | dict[str, Count] | tuple[Placed, ...]) -> tuple[Placed, ...]:
    """Bodies measured together, given by name, by number, or with their poses."""
    if isinstance(bodies, str):
        return (Placed(body=bodies),)
    if isinstance(bodies, dict):
        return tuple(Placed(body=body, count=count) for body, count in bodies.items())
    return bodies
