"""Platforms of a description, and the telescope of a 4-DOF Delta.

With the platform point r, u(θ) = (cos θ, sin θ, 0) and constant d_i, limb i holds the point

    rigid   r + d_i                  only translates (Clavel 1988)
    h4      r ± h u(θ) + d_i         two side bars on a turning middle bar (Pierrot, Company 1999)
    par4    r ± ½ L u(θ) + d_i       two main parts and two rods (Nabat et al. 2005)
    i4      r ± ½ s e + d_i          two half platforms on a slide along e (Krut et al. 2003)

with + for the limbs of the `first` part and − for the others. The tool turns by ψ = k θ or ψ = k s.
"""

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.robot.part import (
    TOOL_ACCELERATION,
    TOOL_SPEED,
    Length,
    Part,
    Point,
    ToolAcceleration,
    ToolAngles,
    ToolSpeed,
)

# `_check` below refuses other values with a message; editors read the limits in the JSON Schema.
Ratio = Annotated[float, Field(ge=-1e3, le=1e3, json_schema_extra={"not": {"const": 0}})]
LimbNumber = Annotated[int, Field(json_schema_extra={"minimum": 1, "maximum": 4})]
# The check of `Telescope` refuses other numbers with a message; editors read this limit.
Stroke = Annotated[float, Field(json_schema_extra={"exclusiveMinimum": 0.0})]


def _direction(angle: float) -> Float[np.ndarray, " 3"]:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


class RigidPlatform(Part):
    """One body that all limbs hold; it only translates."""

    kind: Literal["rigid"] = Field(default="rigid", description="one body that translates")
    bodies: ClassVar[tuple[str, ...]] = ("P",)
    slides: ClassVar[bool] = False
    # Whether the force in each strut of a pair follows from the motion, whatever their stiffness.
    determines_struts: ClassVar[bool] = True


class _Articulated(Part, ABC):
    first: tuple[LimbNumber, ...] = Field(
        default=(1, 2),
        description="numbers of the limbs that hold the first part",
        json_schema_extra={"minItems": 2, "maxItems": 2, "uniqueItems": True},
    )
    ratio: Ratio = Field(
        default=1.0,
        description="k of the tool's angle ψ = k θ (gear, belt), or ψ = k s (rack), rad/m",
    )
    tool_on: Literal["middle", "first", "second"] = Field(
        default="middle", description="what carries the tool: the middle, or one of the two parts"
    )
    tool: Point = Field(
        default=(0.0, 0.0, 0.0), description="tool axis from the point of what carries it, m"
    )
    angle_deg: ToolAngles
    speed_deg_s: ToolSpeed = TOOL_SPEED
    acceleration_deg_s2: ToolAcceleration = TOOL_ACCELERATION

    @model_validator(mode="after")
    def _check(self) -> "_Articulated":
        if self.ratio == 0:
            raise ValueError("ratio is zero; the tool would not turn")
        if len(self.first) != 2 or len({*self.first} & {1, 2, 3, 4}) != 2:
            raise ValueError(
                "first must name two limbs by number, 1 to 4; the others hold the second part"
            )
        return self

    @property
    @abstractmethod
    def arm(self) -> float:
        """Distance of a part from the platform point, h or L/2 [m]; for i4 its share of s, ½."""

    def half(self, psi: float) -> Float[np.ndarray, " 3"]:
        """Vector from platform point to the first part's point [m] at a tool angle [rad]."""
        return self.arm * _direction(psi / self.ratio)

    def on_first(self, limb: int) -> bool:
        """Whether a limb (0, 1, …) holds the first part."""
        return limb + 1 in self.first


class H4Platform(_Articulated):
    """Two side bars, joined by a middle bar that turns by θ about z."""

    kind: Literal["h4"] = Field(description="two side bars on a turning middle bar")
    bodies: ClassVar[tuple[str, ...]] = ("SB", "MB", "EE")
    slides: ClassVar[bool] = False
    determines_struts: ClassVar[bool] = True
    half_length: Length = Field(description="h: middle of the middle bar to its ends, m")

    @property
    def arm(self) -> float:
        return self.half_length

    @model_validator(mode="after")
    def _check_tool(self) -> "H4Platform":
        if self.tool_on == "middle" and (self.tool[0] or self.tool[1]):
            raise ValueError(
                "tool lies beside the middle of the turning middle bar, where nothing carries it; "
                "put it on the first or second side bar with tool_on"
            )
        return self


class Par4Platform(_Articulated):
    """A planar parallelogram of two main parts and two rods that turn by θ about z."""

    kind: Literal["par4"] = Field(description="two main parts and two turning rods")
    bodies: ClassVar[tuple[str, ...]] = ("MP", "R", "EE")
    slides: ClassVar[bool] = False
    determines_struts: ClassVar[bool] = False
    length: Length = Field(description="L of the rods, m")

    @property
    def arm(self) -> float:
        return 0.5 * self.length


class I4Platform(_Articulated):
    """Two half platforms on a slide; their distance s turns the tool by a rack and a pinion."""

    kind: Literal["i4"] = Field(description="two half platforms on a slide")
    bodies: ClassVar[tuple[str, ...]] = ("HP", "EE")
    slides: ClassVar[bool] = True
    determines_struts: ClassVar[bool] = False
    direction_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        default=0.0, description="direction e of the slide about world z, degrees"
    )
    ratio: Ratio = Field(
        description="k of ψ = k s, rad/m: one over the diameter of a pinion between two racks"
    )

    @property
    def arm(self) -> float:
        return 0.5

    @property
    def direction(self) -> Float[np.ndarray, " 3"]:
        """Unit vector e along which the half platforms slide."""
        return _direction(np.deg2rad(self.direction_deg))

    def half(self, psi: float) -> Float[np.ndarray, " 3"]:
        return self.arm * psi / self.ratio * self.direction


# Names of the joints without a drive: the platform's, and the telescope's.
PASSIVE_JOINTS = ("platform", "slide")

Platform = Annotated[
    RigidPlatform | H4Platform | Par4Platform | I4Platform, Field(discriminator="kind")
]


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
