"""Base class of descriptions: frozen, no unknown keys, finite numbers, valid copies.

Bounds of numbers keep products far from overflow and detect wrong units, such as millimetres.
"""

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NoReturn, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from deltaid.errors import DescriptionError
from deltaid.robot.complaints import complaints, require_kinds
from deltaid.robot.yaml_tree import Entry, Value
from deltaid.shown import Named

JointKind = Literal["rotary", "linear"]
Axis = Literal["x", "y", "z"]
_Part = TypeVar("_Part", bound="Part")


class _Fixed(dict[str, Any]):
    """Immutable dictionary of a description: computed values would not follow a change."""

    def _refuse(self: Any, *_: Any, **__: Any) -> NoReturn:
        raise DescriptionError(
            "cannot be changed in place",
            where="a dictionary of a description",
            cure="make a copy, such as robot.changed(friction=robot.friction | {…})",
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type["_Fixed"], tuple[dict[str, Any]]]:
        return _Fixed, (dict(self),)


class Part(Named, BaseModel):
    """A description, or a part of one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        """Validate keys and values as in a file.

        Raises:
            DescriptionError: a key is unknown or missing, or its value is invalid.
        """
        try:
            super().__init__(**values)
            require_kinds(values, self)
        except ValidationError as error:
            raise _refusal(error, values, type(self), type(self).__name__) from None

    # With this mark pydantic builds nested parts itself, and its errors keep their paths.
    vars()["__init__"].__pydantic_base_init__ = True

    def model_post_init(self, _context: Any, /) -> None:
        """Make the dictionaries immutable, which pydantic does not."""
        for key, value in vars(self).items():
            if isinstance(value, dict):
                vars(self)[key] = _Fixed(value)

    @classmethod
    def from_dict(cls: type[_Part], values: Mapping[str, Any], where: str) -> _Part:
        """Build the part from a dictionary, validated like a file.

        Raises:
            DescriptionError: values cannot be written to a file, or are invalid.
        """
        try:
            text = json.dumps(values, default=_as_json)
        except (TypeError, ValueError) as error:
            raise DescriptionError(
                f"no file could hold this dictionary: {error}",
                where=where,
                cure="use text, numbers, lists and dictionaries",
            ) from None
        try:
            part = cls.model_validate_json(text, strict=True)
            require_kinds(json.loads(text), part)
            return part
        except ValidationError as error:
            raise _refusal(error, json.loads(text), cls, where) from None

    def changed(self: _Part, **updates: Any) -> _Part:
        """Copy with other values of some keys, validated as if read from a file.

        Raises:
            DescriptionError: a key is unknown, or its value is invalid.
        """
        values = {key: getattr(self, key) for key in self.model_fields_set} | updates
        try:
            copy = type(self).model_validate(values)
            require_kinds(updates, copy)
        except ValidationError as error:
            raise _refusal(error, values, type(self), type(self).__name__) from None
        copy.__pydantic_private__ = self.__pydantic_private__
        return copy

    def model_copy(
        self: _Part, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> _Part:
        """Copy, validated as by `changed`; pydantic's `model_copy` does not validate."""
        copy = super().model_copy(deep=deep)
        return copy.changed(**update) if update else copy


def _refusal(
    error: ValidationError, values: Mapping[str, Any], kind: type[BaseModel], where: str
) -> DescriptionError:
    keys = ", ".join(kind.model_fields)
    return DescriptionError(
        complaints(Entry(0, _tree(values)), error, kind),
        where=where,
        cure="`deltaid schema robot` prints all keys with their bounds and units"
        if kind.__name__ == "RobotDescription"
        else f"its keys are: {keys}",
    )


def _as_json(value: Any) -> Any:
    """Convert NumPy arrays to lists, NumPy scalars to numbers and parts to dictionaries."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_none=True)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"it has a {type(value).__name__}")


def _tree(value: Any) -> Value:
    if isinstance(value, BaseModel):
        value = dict(value)
    if isinstance(value, Mapping):
        return {str(key): Entry(0, _tree(entry)) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [Entry(0, _tree(entry)) for entry in value]
    return value if isinstance(value, bool | int | float | str) else None


# Bounds of any number: products of several stay far from overflow and underflow.
LARGEST = 1e12
_SMALLEST = 1.0 / LARGEST
# Bounds beyond any such robot, which detect wrong units.
LONGEST, SHORTEST = 100.0, 1e-6  # lengths [m]
_HEAVIEST, _LIGHTEST = 1e6, 1e-9  # masses [kg]
TOP_SPEED = 300.0  # speeds [m/s]
_QUICKEST = 5e3  # accelerations [m/s²]
_STRONGEST = 100.0  # gravity [m/s²]
# Default limits of a tool's speed [°/s] and acceleration [°/s²].
TOOL_SPEED, TOOL_ACCELERATION = 1500.0, 30_000.0


def limited(low: float, high: float, refusal: str) -> AfterValidator:
    """Validator that refuses numbers outside limits, except zero.

    Args:
        refusal: message with a format field for the number.
    """

    def check(value: float) -> float:
        if value and not low <= value <= high:
            raise ValueError(refusal.format(value))
        return value

    return AfterValidator(check)


def require_one(part: BaseModel, *names: str) -> str:
    """Name of the only one of these keys that is given.

    Raises:
        ValueError: none of them is given, or several are.
    """
    given = [name for name in names if getattr(part, name) is not None]
    if len(given) != 1:
        what = f"gives {' and '.join(given) or 'none of them'}"
        raise ValueError(f"{what}: give one of {', '.join(names)}")
    return given[0]


def _increasing(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] >= bounds[1]:
        raise ValueError("must be given as [lowest, highest]")
    return bounds


def _gravity(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) > _STRONGEST:
        raise ValueError(f"{math.hypot(*value):g} m/s² cannot be; gravity is in m/s²")
    return value


def schema_limits(**limits: Any) -> Any:
    """Field that states a validator's limits in the JSON Schema, for editors."""
    return Field(json_schema_extra=limits)


_LENGTH = limited(SHORTEST, LONGEST, "{:g} m cannot be; lengths are in metres")

Positive = Annotated[
    float,
    Field(gt=0, le=LARGEST),
    limited(_SMALLEST, math.inf, "{:g} is next to nothing; is its unit right?"),
    schema_limits(minimum=_SMALLEST),
]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Length = Annotated[float, Field(gt=0), _LENGTH, schema_limits(minimum=SHORTEST, maximum=LONGEST)]
# A length that may be zero.
Radius = Annotated[
    float,
    Field(ge=0),
    _LENGTH,
    schema_limits(maximum=LONGEST, anyOf=[{"const": 0}, {"minimum": SHORTEST}]),
]
Mass = Annotated[
    float,
    Field(gt=0),
    limited(_LIGHTEST, _HEAVIEST, "{:g} kg cannot be; masses are in kilograms"),
    schema_limits(minimum=_LIGHTEST, maximum=_HEAVIEST),
]
Position = Annotated[
    float,
    limited(-LONGEST, LONGEST, "{:g} m cannot be; positions are in metres"),
    schema_limits(minimum=-LONGEST, maximum=LONGEST),
]
Speed = Annotated[
    Positive,
    limited(0.0, TOP_SPEED, "{:g} m/s cannot be; speeds are in metres per second"),
    schema_limits(minimum=_SMALLEST, maximum=TOP_SPEED),
]
Acceleration = Annotated[
    Positive,
    limited(0.0, _QUICKEST, "{:g} m/s² cannot be; accelerations are in metres per second squared"),
    schema_limits(minimum=_SMALLEST, maximum=_QUICKEST),
]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Point = tuple[Position, Position, Position]
# Lowest and highest value [m; degrees].
Range = Annotated[tuple[Position, Position], AfterValidator(_increasing)]
AngleRange = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_increasing)]
_Pull = Annotated[Coordinate, schema_limits(minimum=-_STRONGEST, maximum=_STRONGEST)]
Gravity = Annotated[tuple[_Pull, _Pull, _Pull], AfterValidator(_gravity)]
ToolAngles = Annotated[AngleRange, Field(description="lowest and highest tool angle ψ, degrees")]
ToolSpeed = Annotated[Positive, Field(description="largest tool speed, degrees/s")]
ToolAcceleration = Annotated[Positive, Field(description="largest tool acceleration, degrees/s²")]
