"""Plain data written as YAML."""

import io
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.scalarstring import DoubleQuotedScalarString


def yaml_text(data: dict[str, Any]) -> str:
    """Plain data as YAML, the innermost lists and mappings on one line each."""
    yaml, text = YAML(), io.StringIO()
    yaml.default_flow_style = None
    yaml.width = 100
    yaml.dump(_quoted(data), text)
    return text.getvalue()


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
