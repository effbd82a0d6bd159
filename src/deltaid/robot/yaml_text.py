"""Plain data as YAML text."""

import io
import json
from hashlib import sha256
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

# From so many entries on a list of mappings is written one a line.
_LONG = 50


def yaml_text(data: dict[str, Any]) -> str:
    """Plain data as YAML, the innermost lists and mappings on one line each, and so the entries of
    a long list of mappings, such as a year of recordings."""
    yaml, text, short = YAML(), io.StringIO(), dict(data)
    yaml.default_flow_style = None
    yaml.width = 100
    lists = dict[str, str]()
    for key, value in data.items():
        if isinstance(value, list) and len(value) >= _LONG and (lines := _json_lines(value)):
            name = sha256(lines.encode()).hexdigest()
            short[key], lists[f"- [{name}]\n"] = [[name]], lines
    yaml.dump(_quoted(short), text)
    whole = text.getvalue()
    for place, lines in lists.items():
        whole = whole.replace(place, lines)
    return whole


def _json_lines(entries: list[Any]) -> str:
    """Mappings as items on one line each, of JSON, which is YAML and is written much faster; empty
    where that is not so."""
    lines = [f"- {json.dumps(entry, ensure_ascii=False)}" for entry in entries]
    is_yaml = all(isinstance(entry, dict) for entry in entries)
    is_yaml &= all(line.isprintable() for line in lines)
    return "".join(f"{line}\n" for line in lines) if is_yaml else ""


def _quoted(value: Any) -> Any:
    """Text between quotes where something of it would be lost without.

    Line breaks and control characters; and a question mark or colon at its beginning, which the
    writer leaves plain and the parser takes for the mark of a key or a value.
    """
    if isinstance(value, dict):
        return {key: _quoted(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_quoted(entry) for entry in value]
    special = isinstance(value, str) and (not value.isprintable() or value[:1] in ("?", ":"))
    return DoubleQuotedScalarString(value) if special else value
