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


def _not_tiny(value: float) -> float:
    if value < _SMALLEST:
        raise ValueError(f"{value:g} is next to nothing; is its unit right?")
    return value


def _length(value: float) -> float:
    if not _SHORTEST <= abs(value) <= _LONGEST and value != 0:
        raise ValueError(f"{value:g} m cannot be; lengths are in metres")
    return value


def _mass(value: float) -> float:
    if not _LIGHTEST <= value <= _HEAVIEST:
        raise ValueError(f"{value:g} kg cannot be; masses are in kilograms")
    return value


def _position(value: float) -> float:
    if abs(value) > _LONGEST:
        raise ValueError(f"{value:g} m cannot be; positions are in metres")
    return value


def _speed(value: float) -> float:
    if value > _FASTEST:
        raise ValueError(f"{value:g} m/s cannot be; speeds are in metres per second")
    return value


def _gravity(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) > _STRONGEST:
        raise ValueError(f"{math.hypot(*value):g} m/s² cannot be; gravity is in m/s²")
    return value


def _limits(**limits: Any) -> Any:
    """What validators below refuse, for editors too, which know only the schema."""
    return Field(json_schema_extra=limits)


Positive = Annotated[
    float, Field(gt=0, le=_LARGEST), AfterValidator(_not_tiny), _limits(minimum=_SMALLEST)
]
NotNegative = Annotated[float, Field(ge=0, le=_LARGEST)]
Coordinate = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
Length = Annotated[
    float, Field(gt=0), AfterValidator(_length), _limits(minimum=_SHORTEST, maximum=_LONGEST)
]
# May be zero.
Radius = Annotated[
    float,
    Field(ge=0),
    AfterValidator(_length),
    _limits(maximum=_LONGEST, anyOf=[{"const": 0}, {"minimum": _SHORTEST}]),
]
Mass = Annotated[
    float, Field(gt=0), AfterValidator(_mass), _limits(minimum=_LIGHTEST, maximum=_HEAVIEST)
]
Position = Annotated[float, AfterValidator(_position), _limits(minimum=-_LONGEST, maximum=_LONGEST)]
Speed = Annotated[Positive, AfterValidator(_speed), _limits(minimum=_SMALLEST, maximum=_FASTEST)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Point = tuple[Position, Position, Position]
_Pull = Annotated[Coordinate, _limits(minimum=-_STRONGEST, maximum=_STRONGEST)]
Gravity = Annotated[tuple[_Pull, _Pull, _Pull], AfterValidator(_gravity)]
