"""Proposals applied to a description or a mapping, or written as lines to paste."""

import copy
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from deltaid.check.lengths import checked_lengths
from deltaid.errors import DescriptionError
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.columns import Columns
from deltaid.recording.mapping import QUANTITIES, ColumnMapping
from deltaid.recording.resolution import si_unit
from deltaid.recording.source import Table
from deltaid.robot.load import (
    RobotLike,
    catalogue,
    described,
    described_in,
    holds_a_model,
    plain_data,
    read_text,
    yaml_text,
)

File = Literal["robot", "mapping"]
Changes = dict[str, object]
Data = dict[str, Any]

_STEP = re.compile(r"[^.\[\]]+")


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


def in_metres(robot: RobotLike) -> Verdict | None:
    """The verdict on a file that no robot can be read from, if its lengths are in millimetres."""
    try:
        data = as_written(robot)
        verdict = checked_lengths(data)
        text = yaml_text(mended(data, changes([verdict], "robot")))
        described_in(text, str(robot))
    except DescriptionError:
        return None
    return verdict if verdict.grade is Grade.WRONG else None


def written_out(
    mapping: ColumnMapping | None, table: Table, columns: Columns, linear: tuple[bool, ...]
) -> Data:
    """A mapping's plain data, with the columns that are read under their default names."""
    mapping = mapping or ColumnMapping()
    lists = {
        quantity: [
            {
                "column": channel.column,
                "unit": table.units.get(channel.column, si_unit(quantity, linear=slides)),
            }
            for channel, slides in zip(getattr(columns, quantity), linear, strict=True)
        ]
        for quantity in QUANTITIES
        if getattr(mapping, quantity) is None and getattr(columns, quantity)
    }
    return mapping.model_dump(mode="json", exclude_unset=True) | lists


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
            if isinstance(value, dict):
                target = target.setdefault(step, {})
            else:
                target[step] = value
                break
    return lines


def _steps(path: str) -> list[Any]:
    """'torque[1].sign' as ['torque', 1, 'sign']."""
    return [int(step) if step.isdigit() else step for step in _STEP.findall(path)]


def files_of(verdicts: Iterable[Verdict]) -> tuple[File, ...]:
    """The files that verdicts propose to change."""
    named: set[File] = {p.file for verdict in verdicts for p in verdict.proposals}
    order: tuple[File, ...] = ("robot", "mapping")
    return tuple(file for file in order if file in named)
