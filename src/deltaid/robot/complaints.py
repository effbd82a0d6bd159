"""What pydantic found wrong in a YAML file, as sentences with line and key."""

import difflib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from deltaid.robot.yaml_tree import Entry, child

# Complaints that one message lists.
_MOST = 5
_REASONS = {
    "missing": "is missing",
    "extra_forbidden": "unknown key",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text; put it in quotes",
    "finite_number": "must be a finite number",
    "tuple_type": "must be a list",
    "string_too_short": "must not be empty",
    "model_type": "must hold keys with values",
    "dict_type": "must hold keys with values",
    "union_tag_not_found": "lacks the key {discriminator}",
    "union_tag_invalid": "'{tag!s:.40}' is no {discriminator}; choose from {expected_tags}",
    "too_short": "must have at least {min_length} entries, not {actual_length}",
    "too_long": "must have at most {max_length} entries, not {actual_length}",
}

# A value of the wrong kind; where a key may hold one of several kinds, each says so.
_KINDS = ("float_type", "int_type", "string_type", "tuple_type", "model_type", "dict_type")

# What stands there instead is said by these, or there is nothing.
_SAY_ALL = (
    "missing", "extra_forbidden", "value_error", "string_too_short", "too_short", "too_long",
)  # fmt: skip


@dataclass(frozen=True)
class _Complaint:
    line: int  # 0 if there is none
    path: tuple[str, ...]
    reason: str
    value: str = ""  # what stands there instead, where that is short to say
    of_kind: bool = False

    def __str__(self) -> str:
        said = f"{self.reason}{self.value}"
        if self.line:
            return f"line {self.line}, {'.'.join(self.path) or 'top level'}: {said}"
        return f"{'.'.join(self.path)}: {said}" if self.path else said


def complaints(tree: Entry, error: ValidationError, model: type[BaseModel]) -> str:
    """All that is wrong, as 'line 12, limbs.strut: is missing; …'; the first few if it is a lot.

    Values that come from no file are on line 0, which is not named.
    """
    found = [_locate(tree, dict(item), model) for item in error.errors(include_url=False)]
    # what lies deeper says more
    outer = {c.path[:k] for c in found for k in range(len(c.path))}
    texts = [str(c) for c in _joined([c for c in found if c.path not in outer])]
    more = f"; and {len(texts) - _MOST} more" if len(texts) > _MOST else ""
    return "; ".join(texts[:_MOST]) + more


def _joined(found: list[_Complaint]) -> list[_Complaint]:
    """One complaint a place: what the branches of a union say is joined by 'or'.

    A branch whose kind of value is right knows better what is wrong than one that wants another.
    """
    by_place: dict[tuple[int, tuple[str, ...]], list[_Complaint]] = {}
    for c in found:
        by_place.setdefault((c.line, c.path), []).append(c)
    joined = []
    for (line, path), same in by_place.items():
        best = [c for c in same if not c.of_kind] or same
        first, *others = dict.fromkeys(c.reason for c in best)
        reasons = (first, *(reason.removeprefix("must be ") for reason in others))
        joined.append(_Complaint(line, path, " or ".join(reasons), best[0].value))
    return joined


def _locate(tree: Entry, item: dict[str, Any], model: type[BaseModel]) -> _Complaint:
    path: list[str] = []
    place, kind = tree, item["type"]
    for key in item["loc"]:
        found = child(place.value, key)
        if found is not None:  # else it is the name of a union's branch and no key of the file
            place = found
            path.append(str(key)[:60])
    if kind == "missing":
        missing = item["loc"][-1]
        if isinstance(missing, int):  # entries of a list have no names
            return _Complaint(place.line, tuple(path), f"has no entry {missing + 1}")
        path.append(str(missing))
    hint = _near(path[-1], model) if kind == "extra_forbidden" and path else ""
    complaint = _Complaint(
        place.line, tuple(path), _reason(item) + hint, _value(item), kind in _KINDS
    )
    return _deeper(place, complaint)


def _deeper(place: Entry, complaint: _Complaint) -> _Complaint:
    """The complaint at the key that its reason begins with, such as 'springs.drive1 has …'."""
    first, _, rest = complaint.reason.partition(" ")
    path = first.split(".")
    for key in path:
        found = child(place.value, key)
        if found is None:
            return complaint
        place = found
    return _Complaint(place.line, (*complaint.path, *path), rest)


def _reason(item: dict[str, Any]) -> str:
    if item["type"] in _REASONS:
        return _REASONS[item["type"]].format(**item.get("ctx", {}))
    said = str(item["msg"]).removeprefix("Value error, ")
    return said.replace("Input should be ", "must be ", 1)


def _value(item: dict[str, Any]) -> str:
    """What stands there instead, as ', not 0'; nothing where the reason says it or it is long."""
    value = item.get("input")
    if item["type"] in _SAY_ALL or not isinstance(value, bool | int | float | str | None):
        return ""
    text = json.dumps(value, ensure_ascii=False)
    return f", not {text if len(text) <= 40 else text[:39] + '…'}"


def _near(key: str, model: type[BaseModel]) -> str:
    known = set(_keys(model.model_json_schema())) - {key}  # it may be a key of another place
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.75)
    return f"; did you mean {near[0]}?" if near else ""


def _keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        schema = list(schema.values())
    if isinstance(schema, list):
        for value in schema:
            yield from _keys(value)
