"""Sentences for pydantic's validation errors, with line and key of the YAML file."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from deltaid.errors import few, nearest
from deltaid.grouping import grouped
from deltaid.robot.yaml_tree import Entry, child

# Most complaints that one message lists, so that it stays readable.
_MOST = 5
_REASONS = {
    "missing": "is missing",
    "extra_forbidden": "unknown key",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text; put it in quotes",
    "finite_number": "must be a finite number",
    "tuple_type": "must be a list",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must be a name: a letter, then letters, digits and _",
    "model_type": "must hold keys with values",
    "dict_type": "must hold keys with values",
    "union_tag_not_found": "lacks the key {discriminator}",
    "union_tag_invalid": "'{tag!s:.40}' is no {discriminator}; choose from {expected_tags}",
    "too_short": "must have at least {min_length} entries, not {actual_length}",
    "too_long": "must have at most {max_length} entries, not {actual_length}",
}

# Errors about a value of the wrong type. Each branch of a union reports one.
_KINDS = ("float_type", "int_type", "string_type", "tuple_type", "model_type", "dict_type")

# Errors whose reason already names the value, or that have no value.
_NAME_VALUE = (
    "missing", "extra_forbidden", "value_error", "string_too_short", "too_short", "too_long",
)  # fmt: skip


@dataclass(frozen=True)
class _Complaint:
    line: int  # 0 if the value is from no file
    path: tuple[int | str, ...]
    reason: str
    value: str = ""  # ', not …' with the refused value, shortened
    of_kind: bool = False  # whether the value has the wrong type

    def __str__(self) -> str:
        text, place = f"{self.reason}{self.value}", key_path(self.path)
        if self.line:
            return f"line {self.line}, {place or 'top level'}: {text}"
        return f"{place}: {text}" if place else text


def key_path(path: Iterable[int | str]) -> str:
    """Keys as 'bodies.EE.measured[1].mass': in messages, entries of lists count from 1."""
    keys = [f"[{key + 1}]" if isinstance(key, int) else f".{key}" for key in path]
    return "".join(keys).removeprefix(".")


def complaints(tree: Entry, error: ValidationError, model: type[BaseModel]) -> str:
    """Describe the first errors, as 'line 12, limbs.strut: is missing; …'.

    Values from no file have line 0, which is not shown.
    """
    located = [_locate(tree, dict(item), model) for item in error.errors(include_url=False)]
    outer = {
        c.path[:k] for c in located for k in range(len(c.path))
    }  # deeper ones are more precise
    texts = [str(c) for c in _join_unions([c for c in located if c.path not in outer])]
    return few(texts, _MOST, "; ")


def require_kinds(values: Any, taken: Any) -> None:
    """Refuse a boolean or a text that was taken as a number, and a number taken as a boolean.

    Python and pydantic call `true` equal to 1, so a literal 1 accepts it.

    Args:
        values: keys and values as written.
        taken: the model made from them.

    Raises:
        ValidationError: names the first such value.
    """
    for path, value, number in _confused(values, taken, ()):
        kind = "bool_type" if isinstance(number, bool) else "float_type"
        raise ValidationError.from_exception_data("", [{"type": kind, "loc": path, "input": value}])


def _confused(
    value: Any, taken: Any, path: tuple[int | str, ...]
) -> Iterator[tuple[tuple[int | str, ...], Any, Any]]:
    if isinstance(value, Mapping):
        for key, entry in value.items():
            inner = taken.get(key) if isinstance(taken, Mapping) else getattr(taken, key, None)
            yield from _confused(entry, inner, (*path, key))
    elif isinstance(value, list | tuple) and isinstance(taken, list | tuple):
        for k, (entry, inner) in enumerate(zip(value, taken, strict=False)):
            yield from _confused(entry, inner, (*path, k))
    elif isinstance(value, int | float | str) and isinstance(taken, int | float):
        as_text = isinstance(value, str)
        if as_text or isinstance(value, bool) != isinstance(taken, bool):
            yield path, value, taken


def _join_unions(located: list[_Complaint]) -> Iterator[_Complaint]:
    """Join the reasons of a union's branches by 'or', into one complaint per place.

    Branches that accept the type of the value take precedence over those that refuse it.
    """
    for (line, path), same in grouped(((c.line, c.path), c) for c in located).items():
        best = [c for c in same if not c.of_kind] or same
        first, *others = dict.fromkeys(c.reason for c in best)
        reasons = (first, *(reason.removeprefix("must be ") for reason in others))
        yield _Complaint(line, path, " or ".join(reasons), best[0].value)


def _locate(tree: Entry, item: dict[str, Any], model: type[BaseModel]) -> _Complaint:
    path: list[int | str] = []
    place, kind = tree, item["type"]
    for key in item["loc"]:
        entry = child(place.value, key)
        if entry is not None:  # else the key names a branch of a union and is not in the file
            place = entry
            path.append(key if isinstance(key, int) else str(key)[:60])
    if kind == "missing":
        missing = item["loc"][-1]
        if isinstance(missing, int):  # entries of a list have no names
            return _Complaint(place.line, tuple(path), f"has no entry {missing + 1}")
        path.append(str(missing))
    hint = _suggestion(str(path[-1]), model) if kind == "extra_forbidden" and path else ""
    complaint = _Complaint(
        place.line, tuple(path), _reason(item) + hint, _value(item), kind in _KINDS
    )
    return _at_named_key(place, complaint)


def _at_named_key(place: Entry, complaint: _Complaint) -> _Complaint:
    """Move a complaint to the key that its reason begins with, such as 'springs.drive1 has …'."""
    first, _, rest = complaint.reason.partition(" ")
    path = [int(key) if key.isdecimal() else key for key in first.split(".")]
    for key in path:
        entry = child(place.value, key)
        if entry is None:
            return complaint
        place = entry
    return _Complaint(place.line, (*complaint.path, *path), rest)


def _reason(item: dict[str, Any]) -> str:
    if item["type"] in _REASONS:
        return _REASONS[item["type"]].format(**item.get("ctx", {}))
    message = str(item["msg"]).removeprefix("Value error, ")
    return message.replace("Input should be ", "must be ", 1)


def _value(item: dict[str, Any]) -> str:
    """The refused value, as ', not 0'; empty if the reason names it, or if it is no scalar."""
    value = item.get("input")
    if item["type"] in _NAME_VALUE or not isinstance(value, bool | int | float | str | None):
        return ""
    text = json.dumps(value, ensure_ascii=False)
    return f", not {text if len(text) <= 40 else text[:39] + '…'}"


def _suggestion(key: str, model: type[BaseModel]) -> str:
    known = set(_keys(model.model_json_schema())) - {key}  # the key may be valid elsewhere
    hint = nearest(key, known, cutoff=0.75)
    return f"; {hint.strip()}" if hint else ""


def _keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        schema = list(schema.values())
    if isinstance(schema, list):
        for value in schema:
            yield from _keys(value)
