"""Grouping of values by keys."""

from collections.abc import Hashable, Iterable
from typing import TypeVar

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


def grouped(pairs: Iterable[tuple[_Key, _Value]]) -> dict[_Key, list[_Value]]:
    """Values by key; keys and values keep the order of the pairs."""
    groups = dict[_Key, list[_Value]]()
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups
