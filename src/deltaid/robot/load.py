"""Reading descriptions: YAML to validated models, with the line of whatever is wrong; catalogue."""

import difflib
import json
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from deltaid.errors import DescriptionError
from deltaid.files import written_whole
from deltaid.robot.description import RobotDescription

_Model = TypeVar("_Model", bound=BaseModel)


def catalogue() -> tuple[str, ...]:
    """Names of the shipped robots."""
    folder = resources.files("deltaid.robot") / "catalogue"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml")))


def catalogue_text(name: str) -> str:
    """The description file of a catalogue robot.

    Raises:
        DescriptionError: no such robot.
    """
    if name not in catalogue():
        raise _unknown(name)
    file = resources.files("deltaid.robot") / "catalogue" / f"{name}.yaml"
    return file.read_text(encoding="utf-8")


def load_robot(robot: str | Path) -> RobotDescription:
    """The description of a catalogue robot (by name) or of a YAML file (by path).

    Raises:
        DescriptionError: no such robot or file, or the file does not describe a robot.
    """
    if str(robot) in catalogue():
        return parse(catalogue_text(str(robot)), RobotDescription, where=f"{robot}.yaml")
    path = Path(robot)
    if not path.is_file():
        raise _unknown(str(robot))
    return load_yaml(path, RobotDescription)


def load_yaml(path: Path, model: type[_Model]) -> _Model:
    """Read a YAML file into a pydantic model.

    Raises:
        DescriptionError: the file cannot be read, is not YAML, or does not fit the model.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(f"cannot be read as text: {error}", where=str(path)) from None
    return parse(text, model, where=str(path))


def save_yaml(value: BaseModel, path: Path) -> None:
    """Write a model as YAML, whole or not at all; numbers keep every bit.

    Raises:
        DeltaidError: the file cannot be written.
    """
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 100
    with written_whole(path) as file:
        yaml.dump(value.model_dump(mode="json", exclude_none=True), file)


def parse(text: str, model: type[_Model], *, where: str) -> _Model:
    """Validate YAML text against a model; `where` names the text in messages.

    Raises:
        DescriptionError: with the line, the key and the reason of every complaint.
    """
    try:
        tree = YAML(typ="rt", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark else ""
        raise DescriptionError(
            f"is not valid YAML: {error.problem or error.context}", where=f"{where}{line}"
        ) from None
    except (YAMLError, ValueError) as error:
        raise DescriptionError(f"is not valid YAML: {error}", where=where) from None
    if not isinstance(tree, CommentedMap):
        raise DescriptionError("must be a mapping of keys to values", where=where)
    try:
        return model.model_validate(_plain(tree))
    except ValidationError as error:
        complaints = [_complaint(tree, dict(item)) for item in error.errors()]
        raise DescriptionError(
            "; ".join(complaints),
            where=where,
            cure="`deltaid schema` prints the JSON Schema that editors complete and check with",
        ) from None


def _unknown(name: str) -> DescriptionError:
    near = difflib.get_close_matches(name, catalogue(), n=1, cutoff=0.4)
    hint = f"did you mean {near[0]}? " if near else ""
    return DescriptionError(
        f"no robot file and no catalogue robot called '{name}'",
        cure=f"{hint}the catalogue has: {', '.join(catalogue())}",
    )


def _plain(node: Any) -> Any:
    """Round-trip YAML nodes as plain Python values."""
    if isinstance(node, CommentedMap):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        return [_plain(value) for value in node]
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node


def _complaint(tree: CommentedMap, item: dict[str, Any]) -> str:
    """One validation error as 'line 12, limbs.strut: Field required'."""
    path, line, node = [], 1, tree
    for key in item["loc"]:
        if isinstance(node, CommentedMap) and key in node:
            line = node.lc.key(key)[0] + 1
        elif isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node):
            line = node.lc.item(key)[0] + 1
        else:
            if item["type"] == "missing":
                path.append(str(key))
            continue  # the name of a union's branch is not a key of the file
        node = node[key]
        path.append(str(key))
    reason = str(item["msg"]).removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        reason = "unknown key"
    elif isinstance(item.get("input"), int | float | str) and item["type"] != "value_error":
        reason += f" (got {json.dumps(item['input'])})"
    return f"line {line}, {'.'.join(path) or 'top level'}: {reason}"
