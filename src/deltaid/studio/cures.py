"""Cures that verdicts propose, put into files only when they are asked for, and shown before."""

import difflib
import io
from collections.abc import Mapping, Sequence
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from deltaid.checks.verdicts import mended
from deltaid.errors import DescriptionError
from deltaid.robot.load import catalogue, catalogue_text, described_in
from deltaid.studio.folder import Folder


def difference(name: str, before: str, after: str) -> str:
    """What changes in a file, as a unified diff."""
    lines = difflib.unified_diff(
        before.splitlines(), after.splitlines(), f"{name} (now)", f"{name} (then)", lineterm="", n=1
    )
    return "\n".join(lines)


def wanted(verdict: Mapping[str, Any], file: str) -> list[tuple[str, object]]:
    """What a verdict, as JSON has it, proposes for one file."""
    proposals = [one for one in verdict["proposals"] if one["file"] == file]
    return [(key, value) for one in proposals for key, value in one["changes"].items()]


def robot_cured(text: str, changes: Sequence[tuple[str, object]], where: str) -> str:
    """A robot file with values replaced; comments and all else stay as they are.

    Raises:
        DescriptionError: the text is no description, or what comes out is none.
    """
    yaml = YAML()
    yaml.width = 100
    yaml.preserve_quotes = True
    try:
        data = yaml.load(text)
    except YAMLError as error:
        raise DescriptionError("is no YAML", where=where, cure=str(error)) from None
    written = io.StringIO()
    yaml.dump(mended(data, dict(changes)), written)
    described_in(written.getvalue(), where)
    return written.getvalue()


def own_copy(folder: Folder, robot: str) -> str:
    """The file of a robot that may be edited: a catalogue robot's is written into the folder.

    Raises:
        DeltaidError: it cannot be written.
    """
    if robot not in catalogue():
        return robot
    name = folder.free_name(f"{robot}.yaml")
    folder.write(name, catalogue_text(robot))
    return name
