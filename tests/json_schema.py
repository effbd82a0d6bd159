"""As much of JSON Schema as pydantic writes, to check files against a schema without a library."""

import re
from typing import Any

_TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "null": type(None),
    "integer": int,
    "number": (int, float),
}
_IGNORED = {"type", "$defs", "title", "description", "default", "discriminator", "examples"}
_BOUNDS = {
    "minimum": lambda value, limit: value >= limit,
    "maximum": lambda value, limit: value <= limit,
    "exclusiveMinimum": lambda value, limit: value > limit,
    "exclusiveMaximum": lambda value, limit: value < limit,
    "minItems": lambda value, limit: len(value) >= limit,
    "maxItems": lambda value, limit: len(value) <= limit,
    "minLength": lambda value, limit: len(value) >= limit,
    "minProperties": lambda value, limit: len(value) >= limit,
    "uniqueItems": lambda value, rule: len({repr(one) for one in value}) == len(value),
    "not": lambda value, rule: bool(violations(value, rule)),
    "pattern": lambda value, pattern: re.search(pattern, value) is not None,
}
# What each keyword says something about; all else fits.
_OF = {
    **dict.fromkeys(("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"), (int, float)),
    **dict.fromkeys(("minItems", "maxItems", "uniqueItems"), list),
    **dict.fromkeys(("minLength", "pattern"), str),
    "minProperties": dict,
    "not": object,
}


def violations(value: Any, schema: dict, root: dict | None = None, path: str = "") -> list[str]:
    """Where a value does not fit a schema. An unknown keyword is an error of this checker."""
    root = root or schema
    kind = schema.get("type")
    if kind and not _is_of(value, kind):
        return [f"{path}: is no {kind}"]
    found = []
    for keyword, rule in schema.items():
        if keyword in _IGNORED:
            continue
        if keyword in _BOUNDS:
            fits = not isinstance(value, _OF[keyword]) or _BOUNDS[keyword](value, rule)
        elif keyword == "$ref":
            found += violations(value, _resolve(rule, root), root, path)
            continue
        elif keyword in ("anyOf", "oneOf"):
            fits = any(not violations(value, branch, root, path) for branch in rule)
        elif keyword in ("const", "enum"):
            among = rule if keyword == "enum" else [rule]
            fits = any(value == one and _truth(value) == _truth(one) for one in among)
        elif keyword == "propertyNames":
            fits = all(not violations(name, rule, root) for name in value)
        elif keyword == "patternProperties":
            for pattern, own in rule.items():
                for name in value:
                    if re.search(pattern, name):
                        found += violations(value[name], own, root, f"{path}.{name}")
            continue
        elif keyword in ("properties", "required", "additionalProperties"):
            found += _of_object(keyword, value, schema, root, path)
            continue
        elif keyword in ("items", "prefixItems"):
            rules = rule if keyword == "prefixItems" else [rule] * len(value)
            for i, (item, own) in enumerate(zip(value, rules, strict=False)):
                found += violations(item, own, root, f"{path}.{i}")
            continue
        else:
            raise NotImplementedError(keyword)
        if not fits:
            found.append(f"{path}: violates {keyword} {rule}")
    return found


def _truth(value: Any) -> bool:
    return isinstance(value, bool)


def _is_of(value: Any, kind: str) -> bool:
    truth = isinstance(value, bool) and kind in ("integer", "number")
    return isinstance(value, _TYPES[kind]) and not truth


def _resolve(reference: str, root: dict) -> dict:
    target: Any = root
    for part in reference.removeprefix("#/").split("/"):
        target = target[part]
    return target


def _of_object(keyword: str, value: dict, schema: dict, root: dict, path: str) -> list[str]:
    known, rule = schema.get("properties", {}), schema[keyword]
    if keyword == "required":
        return [f"{path}.{name}: is missing" for name in rule if name not in value]
    inner = [name for name in value if (name in known) == (keyword == "properties")]
    if rule is False:
        return [f"{path}.{name}: is unknown" for name in inner]
    found = []
    for name in inner if rule is not True else ():
        own = known[name] if keyword == "properties" else rule
        found += violations(value[name], own, root, f"{path}.{name}")
    return found
