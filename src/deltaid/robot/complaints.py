"""What pydantic found wrong in a YAML file, as sentences with line and key."""

import json
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError
from ruamel.yaml.comments import CommentedMap, CommentedSeq

_MOST = 5
_REASONS = {
    "missing": "is missing",
    "extra_forbidden": "unknown key",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text; put it in quotes",
    "finite_number": "must be a finite number",
    "tuple_type": "must be a list",
    "model_type": "must hold keys with values",
    "dict_type": "must hold keys with values",
}


@dataclass(frozen=True)
class _Complaint:
    line: int
    path: tuple[str, ...]
    reason: str

    def __str__(self) -> str:
        return f"line {self.line}, {'.'.join(self.path) or 'top level'}: {self.reason}"


def complaints(tree: CommentedMap, error: ValidationError) -> str:
    """All that is wrong, as 'line 12, limbs.strut: is missing; …'; the first few if it is a lot."""
    found = [_locate(tree, dict(item)) for item in error.errors(include_url=False)]
    found = [c for c in found if not any(_below(other.path, c.path) for other in found)]
    texts = [str(c) for c in _joined(found)]
    more = f"; and {len(texts) - _MOST} more" if len(texts) > _MOST else ""
    return "; ".join(texts[:_MOST]) + more


def _below(path: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether a path lies inside another; what lies deeper says more."""
    return len(path) > len(other) and path[: len(other)] == other


def _joined(found: list[_Complaint]) -> list[_Complaint]:
    """One complaint a place: what the branches of a union say is joined by 'or'."""
    by_place: dict[tuple[int, tuple[str, ...]], list[str]] = {}
    for c in found:
        by_place.setdefault((c.line, c.path), []).append(c.reason)
    return [
        _Complaint(line, path, ", or ".join(dict.fromkeys(reasons)))
        for (line, path), reasons in by_place.items()
    ]


def _locate(tree: CommentedMap, item: dict[str, Any]) -> _Complaint:
    path: list[str] = []
    line, node = 1, tree
    for depth, key in enumerate(item["loc"]):
        if isinstance(node, CommentedMap) and key in node:
            line = _line(node.lc.key, key, line)
        elif isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node):
            line = _line(node.lc.item, key, line)
        else:
            if item["type"] == "missing" and depth == len(item["loc"]) - 1:
                path.append(str(key))
            continue  # the name of a union's branch is not a key of the file
        node = node[key]
        path.append(str(key)[:60])
    return _deeper(node, _Complaint(line, tuple(path), _reason(item)))


def _deeper(node: Any, complaint: _Complaint) -> _Complaint:
    """The complaint at the key that its reason begins with, such as 'springs.drive1 has …'."""
    first, _, rest = complaint.reason.partition(" ")
    line, path = complaint.line, list(complaint.path)
    for key in first.split("."):
        if not isinstance(node, CommentedMap) or key not in node:
            return complaint
        line, node = _line(node.lc.key, key, line), node[key]
        path.append(key)
    return _Complaint(line, tuple(path), rest)


def _line(position: Any, key: Any, default: int) -> int:
    """The line of a key or item; merged keys (<<) have none of their own."""
    try:
        return position(key)[0] + 1
    except (KeyError, TypeError):
        return default


def _reason(item: dict[str, Any]) -> str:
    kind, context = item["type"], item.get("ctx", {})
    if kind == "union_tag_not_found":
        return f"lacks the key {context['discriminator']}"
    if kind == "union_tag_invalid":
        tag = str(context["tag"])[:40]
        return f"'{tag}' is no {context['discriminator']}; choose from {context['expected_tags']}"
    reason = _REASONS.get(kind)
    if reason is None:
        reason = str(item["msg"]).removeprefix("Value error, ")
        reason = reason.replace("Input should be ", "must be ", 1)
    if kind in ("missing", "extra_forbidden", "value_error"):
        return reason
    value = item.get("input")
    if isinstance(value, bool | int | float | str) or value is None:
        text = json.dumps(value, ensure_ascii=False)
        reason += f", not {text if len(text) <= 40 else text[:39] + '…'}"
    return reason
