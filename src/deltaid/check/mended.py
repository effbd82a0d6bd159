"""Proposals put into effect: on a description, on a mapping, and as lines to paste."""

import re
from collections.abc import Iterable
from typing import Any, Literal

from deltaid.check.verdict import Verdict
from deltaid.recording.columns import QUANTITIES, ColumnMapping, Columns, si_unit
from deltaid.recording.source import Table
from deltaid.robot.description import RobotDescription

File = Literal["robot", "mapping"]
Changes = dict[str, object]

_STEP = re.compile(r"[^.\[\]]+")


def changes(verdicts: Iterable[Verdict], file: File) -> Changes:
    """What all verdicts propose for one file; of two values for one key the first."""
    proposals = (p for verdict in verdicts for p in verdict.proposals if p.file == file)
    found: Changes = {}
    for proposal in proposals:
        found |= {key: value for key, value in proposal.changes if key not in found}
    return found


def mended_robot(robot: RobotDescription, wanted: Changes) -> RobotDescription:
    """The description with the changes.

    Raises:
        DescriptionError: there is no such key, or it cannot have that value.
    """
    data = _applied(robot.model_dump(mode="json", exclude_none=True), wanted)
    return robot.changed(**{key: data.get(key) for key in {_steps(path)[0] for path in wanted}})


def mended_mapping(mapping: ColumnMapping, wanted: Changes) -> ColumnMapping:
    """The mapping with the changes.

    Raises:
        DescriptionError: there is no such key, or it cannot have that value.
    """
    data = _applied(mapping.model_dump(mode="json", exclude_unset=True), wanted)
    return mapping.changed(**{key: data[key] for key in {_steps(path)[0] for path in wanted}})


def written_out(
    mapping: ColumnMapping | None, table: Table, columns: Columns, linear: tuple[bool, ...]
) -> ColumnMapping:
    """The mapping with every column that is read under its default name written out."""
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
    return mapping.changed(**lists)


def to_paste(mended: RobotDescription | ColumnMapping, wanted: Changes) -> dict[str, Any]:
    """The changed keys and nothing else; a list is given whole, as only that can be pasted."""
    data = mended.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    lines: dict[str, Any] = {}
    for path in wanted:
        here, there = data, lines
        for step in _steps(path):
            if not isinstance(here, dict) or step not in here:
                break
            here = here[step]
            if isinstance(here, dict):
                there = there.setdefault(step, {})
            else:
                there[step] = here
    return lines


def _applied(data: dict[str, Any], wanted: Changes) -> dict[str, Any]:
    """Nested data with values replaced by path, such as `torque[1].sign`; None takes a key out."""
    for path, value in wanted.items():
        *way, last = _steps(path)
        place: Any = data
        for step in way:
            place = place[step] if isinstance(step, int) else place.setdefault(step, {})
        if value is None and isinstance(place, dict):
            place.pop(last, None)
        else:
            place[last] = value
    return data


def _steps(path: str) -> list[Any]:
    """'torque[1].sign' as ['torque', 1, 'sign']."""
    return [int(step) if step.isdigit() else step for step in _STEP.findall(path)]


def files_of(verdicts: Iterable[Verdict]) -> tuple[File, ...]:
    """The files that verdicts propose to change."""
    named: set[File] = {p.file for verdict in verdicts for p in verdict.proposals}
    order: tuple[File, ...] = ("robot", "mapping")
    return tuple(file for file in order if file in named)
