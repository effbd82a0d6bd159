"""Robot catalogue, and YAML files read as validated models, with the line of each error."""

import json
import os
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar, runtime_checkable

from pydantic import BaseModel, Field, ValidationError

from deltaid.errors import DescriptionError, nearest, quoted
from deltaid.files import readable, written_whole
from deltaid.robot.complaints import complaints, require_kinds
from deltaid.robot.description import RobotDescription
from deltaid.robot.fitting_parts import open_limb
from deltaid.robot.own import file_of
from deltaid.robot.yaml_edit import yaml_text
from deltaid.robot.yaml_tree import MOST_NODES, Entry, child, plain, read_tree

_Model = TypeVar("_Model", bound=BaseModel)

_CATALOGUE = resources.files("deltaid.robot") / "catalogue"
# Largest file [bytes]. A model file has about 15 kB; much larger ones are logs, whose parsing as
# YAML takes minutes.
LARGEST_FILE = 1 << 20
# Top-level keys that every model file has and no robot file has.
_OF_MODELS = re.compile(r"^[\"']?(?:robot|parameters)[\"']?\s*:", re.MULTILINE)
# Names of the schema (`deltaid schema KIND`) of models other than robots.
_KINDS = {
    "ColumnMapping": "columns",
    "IdentifiedModel": "model",
    "ModelFile": "model",
    "ValuesFile": "model",
    "Offers": "sensors",
    "Manifest": "fleet",
    "Measurements": "measurements",
}

# Fixes of an invalid file by its kind.
_CURES = {
    "model": "take back what `deltaid identify` wrote, or if it is a robot's own description, give "
    "its keys without `robot:`; "
}
# Fixes of an empty file by its kind.
_STARTS = {
    "columns": "`deltaid columns` writes a mapping",
    "robot": "`deltaid robots clavel-delta3` prints a robot to start from, and "
    "`deltaid columns` writes a mapping",
}


def catalogue() -> tuple[str, ...]:
    """Names of the shipped robots."""
    return tuple(sorted(f.name[:-5] for f in _CATALOGUE.iterdir() if f.name.endswith(".yaml")))


def catalogue_text(name: str) -> str:
    """Text of a catalogue robot's description file.

    Raises:
        DescriptionError: the catalogue has no such robot.
    """
    if name not in catalogue():
        raise _unknown(name, "no catalogue robot")
    return (_CATALOGUE / f"{name}.yaml").read_text(encoding="utf-8")


@runtime_checkable
class HasRobot(Protocol):
    """Object that has a description, such as a model or its dynamics."""

    @property
    def robot(self) -> RobotDescription:
        """Description of the robot."""
        ...


# A robot: a description, an object that has one, a dictionary, a catalogue name, or a file's path.
RobotLike = RobotDescription | HasRobot | Mapping[str, Any] | str | Path


def require_name(robot: object) -> None:
    """Refuse anything but a name or a path.

    Raises:
        DescriptionError: `robot` is something else.
    """
    if not isinstance(robot, str | Path):
        raise DescriptionError(
            f"a {type(robot).__name__} is no robot",
            where="robot",
            cure="give a catalogue name, the path of a file of a robot or a model, what "
            "deltaid.load_robot, deltaid.load or deltaid.identify returns, or a dictionary",
        )


class ModelFile(BaseModel):
    """Model file, of which only the robot is read."""

    robot: RobotDescription
    parameters: Annotated[tuple[Any, ...], Field(min_length=1)]


def load_robot(robot: RobotLike) -> RobotDescription:
    """Description of a catalogue robot (by name), from a robot or model file (by path), from a
    dictionary, or of an object that has one, such as a model.

    Raises:
        DescriptionError: no such robot or file, or it does not describe a robot.
    """
    if isinstance(robot, RobotDescription):
        return robot
    if isinstance(robot, HasRobot):
        return robot.robot
    if isinstance(robot, Mapping):
        return _usable(RobotDescription.from_dict(robot, "robot"), "", "robot")
    require_name(robot)
    if str(robot) in catalogue():
        return parse(catalogue_text(str(robot)), RobotDescription, where=f"{robot}.yaml")
    if not os.path.exists(robot):  # unlike Path.exists it never raises
        raise _unknown(str(robot), "no robot file and no catalogue robot")
    text = read_text(Path(robot))
    if holds_a_model(text):
        return bound(parse(text, ModelFile, where=str(robot)).robot, str(robot))
    return described_in(text, str(robot))


def described_in(text: str, where: str) -> RobotDescription:
    """Description in the text of a robot file.

    Raises:
        DescriptionError: the text does not describe a robot.
    """
    return _usable(parse(text, RobotDescription, where=where), text, where)


def holds_a_model(text: str) -> bool:
    """Whether YAML text is that of a model file, which has the key `robot` or `parameters`."""
    return bool(_OF_MODELS.search(text))


def _usable(robot: RobotDescription, text: str, where: str) -> RobotDescription:
    """Robot bound to its mechanism file.

    Raises:
        DescriptionError: a limb cannot reach the workspace; with its line if there is a text.
    """
    if reason := open_limb(robot):
        limbs = child(_tree(text, where).value, "limbs") if text else None
        strut = limbs and child(limbs.value, "strut")
        line = f"line {strut.line if strut else 1}, " if text else ""
        raise DescriptionError(
            f"{line}limbs.strut: {reason}",
            where=where,
            cure="check strut, upper_arm and radii or points of limbs, and workspace (z < 0 where "
            "the platform is below the base)",
        )
    return bound(robot, where)


def bound(robot: RobotDescription, where: str) -> RobotDescription:
    """Description bound to the Python file that the user has named, if it needs one.

    Raises:
        DescriptionError: it needs a file, but the user has named none or another one.
    """
    if robot.mechanism is None:
        return robot
    own = robot.mechanism.changed(sha256=file_of(robot.mechanism, where).sha256)
    return robot.changed(mechanism=own)


def load_yaml(path: Path, model: type[_Model]) -> _Model:
    """Read a YAML file into a pydantic model.

    Raises:
        DescriptionError: the file cannot be read, is not YAML, or does not fit the model.
    """
    return parse(read_text(path), model, where=str(path))


def save_yaml(value: BaseModel, path: Path) -> None:
    """Write a model as YAML, whole or not at all; numbers keep every bit.

    Raises:
        DeltaidError: the file cannot be written.
    """
    with written_whole(path) as file:
        file.write(yaml_text(value.model_dump(mode="json", exclude_none=True)))


def plain_data(text: str, where: str) -> dict[str, Any]:
    """Keys and values of YAML text, before any validation.

    Raises:
        DescriptionError: the text is not YAML, or has no keys with values.
    """
    return plain(_tree(text, where), where)


def parse(text: str, model: type[_Model], *, where: str, most: int = MOST_NODES) -> _Model:
    """Validate YAML text against a model.

    Numbers must be written as numbers: '0.5' in quotes, 0,5 and true are refused.

    Args:
        where: name of the text in messages.
        most: largest number of nodes.

    Raises:
        DescriptionError: the text is invalid; with line, key and reason of the first errors.
    """
    kind = _KINDS.get(model.__name__, "robot")
    tree = _tree(text, where, most, kind)
    values = plain(tree, where, most)
    try:
        parsed = model.model_validate_json(json.dumps(values), strict=True)
        require_kinds(values, parsed)
        return parsed
    except ValidationError as error:
        raise DescriptionError(
            complaints(tree, error, model),
            where=where,
            cure=f"{_CURES.get(kind, '')}`deltaid schema {kind}` prints the JSON Schema that "
            "editors complete and check with",
        ) from None


def read_text(path: Path) -> str:
    """Text of a file of a description, mapping or model.

    Raises:
        DescriptionError: the file cannot be read, is not UTF-8, or is too large.
    """
    with readable(path, DescriptionError), path.open("rb") as file:
        data = file.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise DescriptionError(
            "is too large for a description, mapping or model",
            where=str(path),
            cure="is it a log? the order of arguments is in --help",
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise DescriptionError(
            "is not text in UTF-8",
            where=f"{path}, line {line}",
            cure="save it as UTF-8; is it a log? the order of arguments is in --help",
        ) from None


def _tree(text: str, where: str, most: int = MOST_NODES, kind: str = "robot") -> Entry:
    tree = read_tree(text, where, most)
    if tree is None or tree.value is None:
        cure = _STARTS.get(kind, f"`deltaid schema {kind}` prints what such a file holds")
        raise DescriptionError("is empty", where=where, cure=cure)
    if not isinstance(tree.value, dict):
        raise DescriptionError(
            "does not hold keys with values (`key: value`)",
            where=where,
            cure="is it a log? the order of arguments is in --help",
        )
    return tree


def _unknown(name: str, missing: str) -> DescriptionError:
    hint = nearest(name, catalogue(), 0.4)
    return DescriptionError(
        f"{missing} called '{quoted(name)}'",
        cure=f"{hint}the catalogue has: {', '.join(catalogue())}",
    )
