"""What pydantic found wrong in a YAML file, as sentences with line and key."""

import difflib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from deltaid.robot.yaml_tree import Entry, Value, child

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
    outer = {path[:k] for path in (c.path for c in found) for k in range(len(path))}
    found = [c for c in found if c.path not in outer]
    texts = [str(c) for c in _joined(found)]
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
        reasons = list(dict.fromkeys(c.reason for c in best))
        reasons[1:] = [reason.removeprefix("must be ") for reason in reasons[1:]]
        joined.append(_Complaint(line, path, " or ".join(reasons), best[0].value))
    return joined


def _locate(tree: Entry, item: dict[str, Any], model: type[BaseModel]) -> _Complaint:
    path: list[str] = []
    line, node = tree.line, tree.value
    for depth, key in enumerate(item["loc"]):
        found = child(node, key)
        if found is None:
            if item["type"] == "missing" and depth == len(item["loc"]) - 1:
                if isinstance(key, int):  # entries of a list have no names
                    return _Complaint(line, tuple(path), f"has no entry {key + 1}")
                path.append(str(key))
            continue  # the name of a union's branch is not a key of the file
        line, node = found.line, found.value
        path.append(str(key)[:60])
    value, of_kind = _value(item), item["type"] in _KINDS
    hint = _near(path[-1], model) if item["type"] == "extra_forbidden" and path else ""
    return _deeper(node, _Complaint(line, tuple(path), _reason(item) + hint, value, of_kind))


def _deeper(node: Value, complaint: _Complaint) -> _Complaint:
    """The complaint at the key that its reason begins with, such as 'springs.drive1 has …'."""
    first, _, rest = complaint.reason.partition(" ")
    line, path = complaint.line, list(complaint.path)
    for key in first.split("."):
        found = child(node, key)
        if found is None:
            return complaint
        line, node = found.line, found.value
        path.append(key)
    return _Complaint(line, tuple(path), rest)


def _reason(item: dict[str, Any]) -> str:
    kind, context = item["type"], item.get("ctx", {})
    if kind == "union_tag_not_found":
        return f"lacks the key {context['discriminator']}"
    if kind == "union_tag_invalid":
        tag = str(context["tag"])[:40]
        return f"'{tag}' is no {context['discriminator']}; choose from {context['expected_tags']}"
    reason = _REASONS.get(kind)
    if kind in ("too_short", "too_long"):
        word, key = ("least", "min_length") if kind == "too_short" else ("most", "max_length")
        return f"must have at {word} {context[key]} entries, not {context['actual_length']}"
    if reason is None:
        reason = str(item["msg"]).removeprefix("Value error, ")
        reason = reason.replace("Input should be ", "must be ", 1)
    return reason


def _value(item: dict[str, Any]) -> str:
    """What stands there instead, as ', not 0'; nothing where the reason says it or it is long."""
    if item["type"] in _SAY_ALL:
        return ""
    value = item.get("input")
    if isinstance(value, bool | int | float | str) or value is None:
        text = json.dumps(value, ensure_ascii=False)
        return f", not {text if len(text) <= 40 else text[:39] + '…'}"
    return ""


def _near(key: str, model: type[BaseModel]) -> str:
    """The known key that an unknown one may be a slip of."""
    known = set(_keys(model.model_json_schema())) - {key}  # it may be a key of another place
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.75)
    return f"; did you mean {near[0]}?" if near else ""


def _keys(schema: Any) -> Iterator[str]:
    """All keys that a JSON Schema has anywhere."""
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for value in schema.values():
            yield from _keys(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from _keys(value)
