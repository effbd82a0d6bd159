"""The telescope bar of a 4-DOF Delta as a user writes it."""

from typing import Annotated

from pydantic import Field, model_validator

from deltaid.robot.part import Part
from deltaid.robot.quantities import Point

# Positive, which `_check` says in its own words.
Stroke = Annotated[float, Field(json_schema_extra={"exclusiveMinimum": 0.0})]


class Telescope(Part):
    """Telescope bar (Cardan axle) from base to platform; adds the rotation ψ as fourth axis."""

    base_joint: Point = Field(
        default=(0.0, 0.0, 0.0), description="centre of the upper universal joint in the world, m"
    )
    platform_joint: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of the lower universal joint from the platform point, m",
    )
    stroke: tuple[Stroke, Stroke] | None = Field(
        default=None, description="shortest and longest distance of the two universal joints, m"
    )

    @model_validator(mode="after")
    def _check(self) -> "Telescope":
        if self.stroke is not None and not 0 < self.stroke[0] < self.stroke[1]:
            raise ValueError("stroke must be given as [shortest, longest], both positive")
        return self
