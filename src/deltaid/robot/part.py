"""What all descriptions have in common: frozen, no unknown keys, finite numbers, valid copies."""

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from deltaid.errors import DescriptionError
from deltaid.robot.complaints import complaints
from deltaid.robot.yaml_tree import Entry, Value
from deltaid.shown import Named

_Part = TypeVar("_Part", bound="Part")
_Init = TypeVar("_Init", bound=Callable[..., None])

# Keys that a message names; of a kind with more of them, `deltaid schema` prints all.
_FEW = 30


def _only_when_called(init: _Init) -> _Init:
    """Pydantic then makes parts of a larger whole itself, so that it knows where each one is."""
    vars(init)["__pydantic_base_init__"] = True
    return init


class Part(Named, BaseModel):
    """A description, or a part of one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @_only_when_called
    def __init__(self, /, **values: Any) -> None:
        """Keys and values as in a file.

        Raises:
            DescriptionError: there is no such key, one is missing, or cannot have that value.
        """
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise _refusal(error, values, type(self), type(self).__name__) from None

    @classmethod
    def from_dict(cls: type[_Part], values: Mapping[str, Any], where: str) -> _Part:
        """What a dictionary describes, which is held to the same as a file.

        Raises:
            DescriptionError: a file could not hold these values, or they do not fit.
        """
        try:
            text = json.dumps(values, default=_listed)
        except (TypeError, ValueError) as error:
            raise DescriptionError(
                f"no file could hold this dictionary: {error}",
                where=where,
                cure="use text, numbers, lists and dictionaries",
            ) from None
        try:
            return cls.model_validate_json(text, strict=True)
        except ValidationError as error:
            raise _refusal(error, json.loads(text), cls, where) from None

    def changed(self: _Part, **updates: Any) -> _Part:
        """A copy with other values under some keys, validated as if read from a file.

        Raises:
            DescriptionError: there is no such key, or it cannot have that value.
        """
        values = {key: getattr(self, key) for key in self.model_fields_set} | updates
        try:
            copy = type(self).model_validate(values)
        except ValidationError as error:
            raise _refusal(error, values, type(self), type(self).__name__) from None
        copy.__pydantic_private__ = self.__pydantic_private__
        return copy

    def model_copy(
        self: _Part, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> _Part:
        """A copy; with `update` the same as `changed`, which pydantic's own would not validate."""
        copy = super().model_copy(deep=deep)
        return copy.changed(**update) if update else copy


def _refusal(
    error: ValidationError, values: Mapping[str, Any], kind: type[BaseModel], where: str
) -> DescriptionError:
    """What pydantic found wrong in values that come from no file."""
    keys = ", ".join(kind.model_fields)
    few = len(kind.model_fields) <= _FEW and kind.__name__ != "RobotDescription"
    return DescriptionError(
        complaints(Entry(0, _tree(values)), error, kind),
        where=where,
        cure=f"its keys are: {keys}"
        if few
        else "`deltaid schema robot` prints all keys with their bounds and units",
    )


def _listed(value: Any) -> Any:
    """An array or a number of NumPy as JSON would have it; a part as its keys and values."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_none=True)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"it has a {type(value).__name__}")


def _tree(value: Any) -> Value:
    """Values as a file would hold them, without lines."""
    if isinstance(value, BaseModel):
        value = dict(value)
    if isinstance(value, Mapping):
        return {str(key): Entry(0, _tree(entry)) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [Entry(0, _tree(entry)) for entry in value]
    return value if isinstance(value, bool | int | float | str) else None
