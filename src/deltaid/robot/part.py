"""What all descriptions have in common: frozen, no unknown keys, finite numbers, valid copies."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from deltaid.errors import DescriptionError
from deltaid.robot.complaints import complaints
from deltaid.robot.yaml_tree import Entry, Value

_Part = TypeVar("_Part", bound="Part")


class Part(BaseModel):
    """A description, or a part of one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def changed(self: _Part, **updates: Any) -> _Part:
        """A copy with other values under some keys, validated as if read from a file.

        Raises:
            DescriptionError: there is no such key, or it cannot have that value.
        """
        values = {key: getattr(self, key) for key in self.model_fields_set} | updates
        try:
            copy = type(self).model_validate(values)
        except ValidationError as error:
            raise DescriptionError(
                complaints(Entry(0, _tree(values)), error, type(self)),
                where=type(self).__name__,
                cure="`deltaid schema robot` prints all keys with their bounds and units",
            ) from None
        copy.__pydantic_private__ = self.__pydantic_private__
        return copy

    def model_copy(
        self: _Part, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> _Part:
        """A copy; with `update` the same as `changed`, which pydantic's own would not validate."""
        copy = super().model_copy(deep=deep)
        return copy.changed(**update) if update else copy


def _tree(value: Any) -> Value:
    """Values as a file would hold them, without lines."""
    if isinstance(value, BaseModel):
        value = dict(value)
    if isinstance(value, Mapping):
        return {str(key): Entry(0, _tree(entry)) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [Entry(0, _tree(entry)) for entry in value]
    return value if isinstance(value, bool | int | float | str) else None
