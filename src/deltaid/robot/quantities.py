"""Numbers in files: finite, of the right sign, and no larger or smaller than a machine has them.

The bounds keep every product of such numbers far from overflow, and lengths in millimetres, which
would pass for a giant's, get a message of their own.
"""

import math
from typing import Annotated, Any

from pydantic import AfterValidator, Field

_LARGEST, _SMALLEST = 1e12, 1e-12  # so that no product of several is near overflow
_LONGEST, _SHORTEST = 100.0, 1e-6  # m
_HEAVIEST, _LIGHTEST = 1e6, 1e-9  # kg
_FASTEST = 300.0  # m/s
_STRONGEST = 100.0  # m/s², of gravity


def limited(low: float, high: float, refusal: str) -> AfterValidator:
    """Refuse numbers but zero outside of limits; `refusal` has a place for the number."""

    def check(value: float) -> float:
        if value and not low <= value <= high:
            raise ValueError(refusal.format(value))
        return value

    return AfterValidator(check)


def _gravity(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) > _STRONGEST:
        raise ValueError(f"{math.hypot(*value):g} m/s² cannot be; gravity is in m/s²")
    return value


def _limits(**limits: Any) -> Any:
    """What validators below refuse, for editors too, which know only the schema."""
    return Field(json_schema_extra=limits)


_NOT_TINY = limited(_SMALLEST, math.inf, "{:g} is next to nothing; is its unit right?")
_LENGTH = limited(_SHORTEST, _LONGEST, "{:g} m cannot be; lengths are in metres")
_MASS = limited(_LIGHTEST, _HEAVIEST, "{:g} kg cannot be; masses are in kilograms")
_POSITION = limited(-_LONGEST, _LONGEST, "{:g} m cannot be; positions are in metres")
_SPEED = limited(0.0, _FASTEST, "{:g} m/s cannot be; speeds are in metres per second")

Positive = Annotated[float, Field(gt=0, le=_LARGEST), _NOT_TINY, _limits(minimum=_SMALLEST)]
NotNegative = Annotated[float, Field(ge=0, le=_LARGEST)]
Coordinate = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
Length = Annotated[float, Field(gt=0), _LENGTH, _limits(minimum=_SHORTEST, maximum=_LONGEST)]
# May be zero.
Radius = Annotated[
    float,
    Field(ge=0),
    _LENGTH,
    _limits(maximum=_LONGEST, anyOf=[{"const": 0}, {"minimum": _SHORTEST}]),
]
Mass = Annotated[float, Field(gt=0), _MASS, _limits(minimum=_LIGHTEST, maximum=_HEAVIEST)]
Position = Annotated[float, _POSITION, _limits(minimum=-_LONGEST, maximum=_LONGEST)]
Speed = Annotated[Positive, _SPEED, _limits(minimum=_SMALLEST, maximum=_FASTEST)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Point = tuple[Position, Position, Position]
_Pull = Annotated[Coordinate, _limits(minimum=-_STRONGEST, maximum=_STRONGEST)]
Gravity = Annotated[tuple[_Pull, _Pull, _Pull], AfterValidator(_gravity)]
