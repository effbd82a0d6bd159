"""Numbers in files: finite, of the right sign, and no larger or smaller than a machine has them.

The bounds keep every product of such numbers far from overflow, and lengths in millimetres, which
would pass for a giant's, get a message of their own.
"""

from typing import Annotated

from pydantic import AfterValidator, Field

_LARGEST, _SMALLEST = 1e12, 1e-12
_LONGEST, _SHORTEST = 100.0, 1e-6  # m
_HEAVIEST, _LIGHTEST = 1e6, 1e-9  # kg


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


Positive = Annotated[float, Field(gt=0, le=_LARGEST), AfterValidator(_not_tiny)]
NotNegative = Annotated[float, Field(ge=0, le=_LARGEST)]
Coordinate = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
Length = Annotated[float, Field(gt=0), AfterValidator(_length)]
Radius = Annotated[float, Field(ge=0), AfterValidator(_length)]  # may be zero
Mass = Annotated[float, Field(gt=0), AfterValidator(_mass)]
Position = Annotated[float, AfterValidator(_position)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Point = tuple[Position, Position, Position]
