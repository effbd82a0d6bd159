"""Proposals applied to a description or a mapping, or written as lines to paste."""

import copy
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from deltaid.check.evidence import Evidence
from deltaid.model.verdict import Verdict
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import (
    RobotLike,
    catalogue,
    described,
    described_in,
    holds_a_model,
    parse,
    plain_data,
    read_text,
    yaml_text,
)

File = Literal["robot", "mapping"]
Changes = dict[str, object]
Data = dict[str, Any]

_STEP = re.compile(r"[^.\[\]]+")


def files_of(verdicts: Iterable[Verdict]) -> tuple[File, ...]:
    """The files that verdicts propose to change."""
    named: set[File] = {p.file for verdict in verdicts for p in verdict.proposals}
    order: tuple[File, ...] = ("robot", "mapping")
    return tuple(file for file in order if file in named)


def changes(verdicts: Iterable[Verdict], file: File) -> Changes:
    """What all verdicts propose for one file; of two values for one key the first."""
    proposals = (p for verdict in verdicts for p in verdict.proposals if p.file == file)
    chosen: Changes = {}
    for proposal in proposals:
        chosen |= {key: value for key, value in proposal.changes if key not in chosen}
    return chosen


def as_written(robot: RobotLike) -> Data:
    """A description as the plain data of its file, even with impossible numbers.

    Raises:
        DescriptionError: there is no such robot, or its file is no mapping of keys.
    """
    if isinstance(robot, str | Path) and str(robot) not in catalogue() and os.path.exists(robot):
        text = read_text(Path(robot))
        if not holds_a_model(text):
            return plain_data(text, str(robot))
    return described(robot).model_dump(mode="json", exclude_none=True)


def cured_robot(robot: RobotDescription, verdicts: Iterable[Verdict]) -> RobotDescription:
    """A description with all that verdicts propose for it.

    Raises:
        DescriptionError: what is proposed does not fit.
    """
    if not (proposed := changes(verdicts, "robot")):
        return robot
    return described_in(yaml_text(mended(as_written(robot), proposed)), "cured robot")


def cured_mapping(record: Evidence, verdicts: Iterable[Verdict]) -> ColumnMapping:
    """The mapping of a recording, its columns named, with all that verdicts propose for it.

    Raises:
        RecordingError: what is proposed does not fit.
    """
    text = yaml_text(mended(record.written_mapping, changes(verdicts, "mapping")))
    return parse(text, ColumnMapping, where="cured mapping").of("cured mapping")


def mended(data: Data, proposed: Changes) -> Data:
    """The data with values replaced by path, such as `torque[1].sign`; None takes a key out."""
    data = copy.deepcopy(data)
    for path, value in proposed.items():
        *parents, last = _steps(path)
        place: Any = data
        for step in parents:
            place = place[step] if isinstance(step, int) else place.setdefault(step, {})
        if value is None and isinstance(place, dict):
            place.pop(last, None)
        else:
            place[last] = value
    return data


def pasted(data: Data, proposed: Changes) -> str:
    """What is proposed for plain data, as lines of YAML to paste into its file."""
    return yaml_text(to_paste(mended(data, proposed), proposed)).rstrip()


def to_paste(data: Data, proposed: Changes) -> Data:
    """The changed keys of mended data and nothing else; of a list all, as it is pasted whole."""
    lines: Data = {}
    for path in proposed:
        value: Any = data
        target = lines
        for step in _steps(path):
            if step not in value:
                break
            value = value[step]
            if not isinstance(value, dict):
                target[step] = value
                break
            target = target.setdefault(step, {})
    return lines


def _steps(path: str) -> list[Any]:
    """'torque[1].sign' as ['torque', 1, 'sign']."""
    return [int(step) if step.isdigit() else step for step in _STEP.findall(path)]
