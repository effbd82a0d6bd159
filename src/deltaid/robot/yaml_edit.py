"""Writes plain data as YAML, and replaces values of a YAML file by path, such as `torque[1].sign`.

Edits keep comments, order and the digits of numbers. They replace text between the parser's marks
and parse the result. If it is not the intended data (shared anchors, replaced blocks), ruamel.yaml
rewrites the file, which keeps comments and order, but not the layout.
"""

import copy
import io
import json
import re
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import CollectionNode, MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from deltaid.errors import DescriptionError
from deltaid.robot.complaints import key_path
from deltaid.robot.yaml_tree import plain, read_tree

Data = dict[str, Any]

# Length from which a list of mappings is written as one line of JSON per entry, which is faster.
_LONG = 50


def yaml_text(data: Data) -> str:
    """Plain data as YAML; each innermost list or mapping and each entry of a long list is on one
    line."""
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
    """Mappings as lines of JSON, which is valid YAML; empty if some entry is not a mapping or has
    unprintable characters."""
    lines = [f"- {json.dumps(entry, ensure_ascii=False)}" for entry in entries]
    is_yaml = all(isinstance(entry, dict) for entry in entries)
    is_yaml &= all(line.isprintable() for line in lines)
    return "".join(f"{line}\n" for line in lines) if is_yaml else ""


def _quoted(value: Any) -> Any:
    """Quote text that would not be read back equal.

    This is text with line breaks or control characters, or with a leading question mark or colon,
    which the writer leaves plain and the parser reads as the mark of a key or value.
    """
    if isinstance(value, dict):
        return {key: _quoted(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_quoted(entry) for entry in value]
    special = isinstance(value, str) and (not value.isprintable() or value[:1] in ("?", ":"))
    return DoubleQuotedScalarString(value) if special else value


class _LayoutError(Exception):
    """Raised for a value that cannot be edited in place."""


def with_changes(data: Data, proposed: Mapping[str, object]) -> Data:
    """Copy of the data with values replaced by path; None removes a key."""
    data = copy.deepcopy(data)
    for path, value in proposed.items():
        *parents, last = steps_of(path)
        place: Any = data
        for step in parents:
            place = place[step] if isinstance(step, int) else place.setdefault(step, {})
        if value is None and isinstance(place, dict):
            place.pop(last, None)
        else:
            place[last] = value
    return data


def steps_of(path: str) -> list[Any]:
    """Split a path: 'torque[1].sign' gives ['torque', 1, 'sign']."""
    return [int(step) if step.isdigit() else step for step in re.findall(r"[^.\[\]]+", path)]


def place_in_words(path: str) -> str:
    """The path as messages have it, where entries of lists count from 1."""
    return key_path(steps_of(path))


def edited(text: str, proposed: Mapping[str, object], wanted: Data, where: str) -> str:
    """Text of a YAML file with values replaced by path.

    Args:
        text: the file's present text.
        proposed: values by path; None removes a key.
        wanted: the intended data, from which missing top-level keys are taken.
        where: name of the file in messages.

    Raises:
        DescriptionError: the text is not YAML.
    """
    now = _plain(text, where)
    added = {top: wanted[top] for path in proposed if (top := steps_of(path)[0]) not in now}
    added = {top: value for top, value in added.items() if value is not None}
    changes = added | {p: value for p, value in proposed.items() if steps_of(p)[0] in now}
    aim = with_changes(now | added, changes)
    result = text
    try:
        for path, value in changes.items():
            result = _with_value(result, steps_of(path), value)
        if _plain(result, where) == aim:
            return result
    except (_LayoutError, DescriptionError, YAMLError):
        pass
    return _by_ruamel(text, changes)


def _plain(text: str, where: str) -> Data:
    tree = read_tree(text, where)
    return {} if tree is None or tree.value is None else plain(tree, where)


def _by_ruamel(text: str, changes: Mapping[str, object]) -> str:
    yaml, written = YAML(), io.StringIO()
    yaml.width, yaml.preserve_quotes = 100, True
    yaml.dump(with_changes(yaml.load(text) or {}, changes), written)
    return written.getvalue()


def _with_value(text: str, steps: list[Any], value: object) -> str:
    parser: Any = YAML(typ="safe", pure=True)
    node: Node | None = parser.compose(text)
    if node is None:
        return f"{text.rstrip()}\n{_block(steps, value)}\n".lstrip("\n")
    parent: Node = node
    for depth, step in enumerate(steps):
        child = _child(node, step)
        if child is None:
            return text if value is None else _inserted(text, node, steps[depth:], value)
        parent, node = node, child
    if value is None and isinstance(parent, MappingNode):
        return _removed(text, parent, steps[-1])
    if isinstance(node, CollectionNode) and not node.flow_style:
        raise _LayoutError
    return text[: node.start_mark.index] + _flow(value) + text[node.end_mark.index :]


def _child(node: Node, step: object) -> Node | None:
    if isinstance(node, MappingNode):
        return next((value for key, value in node.value if key.value == str(step)), None)
    if isinstance(node, SequenceNode) and isinstance(step, int) and step < len(node.value):
        return node.value[step]
    return None


def _inserted(text: str, node: Node, steps: list[Any], value: object) -> str:
    if isinstance(node, ScalarNode) and node.start_mark.index == node.end_mark.index:
        at = node.start_mark.index
        return f"{text[:at]} {_flow(_nested(steps, value))}{text[at:]}"
    if not isinstance(node, MappingNode) or not node.value:
        raise _LayoutError
    if node.flow_style:
        at = len(text[: node.end_mark.index - 1].rstrip().rstrip(","))
        new = _flow(_nested(steps, value))[1:-1]
        return f"{text[:at]}, {new}{text[node.end_mark.index - 1 :]}"
    at = text.find("\n", _end(node))
    at = len(text) if at < 0 else at
    indent = " " * node.value[0][0].start_mark.column
    lines = _block(steps, value).splitlines()
    return text[:at] + "".join(f"\n{indent}{line}" for line in lines) + text[at:]


def _removed(text: str, parent: MappingNode, key: object) -> str:
    if len(parent.value) < 2:
        raise _LayoutError
    place = next(k for k, (name, _) in enumerate(parent.value) if name.value == str(key))
    name, value = parent.value[place]
    if not parent.flow_style:
        start = text.rfind("\n", 0, name.start_mark.index) + 1
        stop = text.find("\n", _end(value))
        if text[start : name.start_mark.index].strip():  # the first key of an item: `- key: …`
            raise _LayoutError
        return text[:start] + (text[stop + 1 :] if stop >= 0 else "")
    if place + 1 < len(parent.value):
        start, stop = name.start_mark.index, parent.value[place + 1][0].start_mark.index
    else:
        start, stop = parent.value[place - 1][1].end_mark.index, value.end_mark.index
    return text[:start] + text[stop:]


def _end(node: Node) -> int:
    """Index after a node's last character; the end mark of a block is only at the next node."""
    if not isinstance(node, CollectionNode) or node.flow_style or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end(last[1] if isinstance(node, MappingNode) else last)


def _nested(steps: list[Any], value: object) -> Data:
    for step in reversed(steps):
        value = {step: value}
    if not isinstance(value, dict) or any(isinstance(step, int) for step in steps):
        raise _LayoutError
    return value


def _block(steps: list[Any], value: object) -> str:
    (key, value), *_ = _nested(steps, value).items()
    is_short = not isinstance(value, dict | list)
    return f"{key}: {_flow(value)}" if is_short else yaml_text({key: value}).rstrip()


def _flow(value: object) -> str:
    yaml, text = YAML(), io.StringIO()
    yaml.default_flow_style, yaml.width = True, 1 << 16
    yaml.dump({"value": value}, text)
    return text.getvalue().strip()[len("{value: ") : -1]
