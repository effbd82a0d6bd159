"""Edits of files: a mapping by its form, and changes that verdicts propose.

Functions map plain data to plain data and keep everything that is not edited. Proposals are written
only on request, after their changes have been shown.
"""

import copy
import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from deltaid.recording.column_meanings import groups_of, kind_of, read_name
from deltaid.recording.mapped_columns import (
    NEEDED_OF_DRIVES,
    SHORT_NAMES,
    TIMES,
    AllDrives,
    Quantity,
)
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.load import catalogue, catalogue_text, parse, plain_data, yaml_text
from deltaid.studio.folder import Folder

Data = dict[str, Any]

# Default values of an entry, which files omit.
DEFAULTS: Data = {"sign": 1, "zero": 0.0, "gear": 1.0, "lead": None, "torque_constant": None}
# Keys that have the same value for equal drives.
ALIKE = ("unit", "gear", "lead", "torque_constant")
UNITS: dict[Quantity, tuple[str, ...]] = {
    "position": ("rad", "deg", "rev", "360/65536 deg", "m", "mm"),
    "velocity": ("rad/s", "deg/s", "rpm", "rev/s", "m/s", "mm/s"),
    "acceleration": ("rad/s^2", "deg/s^2", "m/s^2", "mm/s^2"),
    "torque": ("N m", "mN*m", "A", "mA", "N", "lbf*in", "0.01 N*m"),
}
# Quantities of the usual units, for which pint need not be loaded.
_KINDS = {
    unit: "current" if unit in ("A", "mA") else quantity
    for quantity, units in UNITS.items()
    for unit in units
}
TIME_UNITS = ("s", "ms", "us", "ns", "100 ns")


def read(text: str, name: str) -> Data:
    """The data of a mapping file.

    Raises:
        DescriptionError: the text is no mapping.
    """
    if not text.strip():
        return {}
    parse(text, ColumnMapping, where=name)
    return plain_data(text, name)


def written(data: Data, name: str) -> str:
    """The text of a mapping file.

    Raises:
        DescriptionError: the data are no valid mapping.
    """
    text = yaml_text(data)
    parse(text, ColumnMapping, where=name)
    return text


def entries(data: Data, quantity: Quantity, dof: int) -> list[Data]:
    """Entries of all drives; empty ones if the quantity is not mapped."""
    given = data.get(quantity)
    if isinstance(given, dict):
        listed = AllDrives.model_validate(
            {k: tuple(v) if isinstance(v, list) else v for k, v in given.items()}
        ).entries(dof, quantity)
        return [entry.model_dump(mode="json", exclude_unset=True) for entry in listed]
    listed = [dict(entry) for entry in given or ()]
    return listed + [{} for _ in range(dof - len(listed))]


def named(data: Data, dof: int) -> set[str]:
    """All columns that a mapping names for time and drives."""
    listed = [entry for quantity in UNITS for entry in entries(data, quantity, dof)]
    return {str(e["column"]) for e in (data.get("time", {}), *listed) if "column" in e}


def with_value(
    data: Data, quantity: Quantity, drive: int, key: str, value: object, dof: int, *, alike: bool
) -> Data:
    """The data with a changed value in one drive's entry, or in all entries if drives are equal.

    A default value removes the key; without a column the whole entry is removed.
    """
    listed = copy.deepcopy(entries(data, quantity, dof))
    for k, entry in enumerate(listed):
        if k == drive or (alike and key in ALIKE and entry):
            entry[key] = value
            if value in (None, "") or (key in DEFAULTS and value == DEFAULTS[key]):
                del entry[key]
    return _with_entries(data, quantity, listed)


def with_column(
    data: Data, quantity: Quantity, drive: int, column: str | None, names: Sequence[str], dof: int,
    *, alike: bool,
) -> Data:  # fmt: skip
    """The data with the column of one drive; without a column the entry is removed.

    The entry gets the unit that the column's name states. If drives are equal, it gets unit and
    gear of the others instead; the first chosen column also selects those of the other drives,
    whose names differ in the axis only.

    Args:
        names: of all columns of the recording.
    """
    data = with_value(data, quantity, drive, "column", column, dof, alike=False)
    if not column:
        return data
    listed, chosen = entries(data, quantity, dof), {drive: column}
    if alike and sum("column" in entry for entry in listed) == 1:
        places = (group.places for group in groups_of(names, dof))
        axes = next((p for p in places if names[p[drive]] == column), ())
        chosen |= {axis: names[place] for axis, place in enumerate(axes)}
    for axis, name in chosen.items():
        entry, unit = listed[axis], read_name(name).unit
        others = [other for i, other in enumerate(listed) if i != axis and "column" in other]
        shared = {key: other[key] for other in others for key in ALIKE if key in other}
        stated = {"column": name} | ({"unit": unit} if unit else {})
        missing = {k: v for k, v in shared.items() if alike and k not in entry}
        listed[axis] = stated | entry | missing
    return _with_entries(data, quantity, listed)


def _with_entries(data: Data, quantity: Quantity, listed: list[Data]) -> Data:
    others = copy.deepcopy(data)
    if any("column" in entry for entry in listed):
        return others | {quantity: listed}
    others.pop(quantity, None)
    return others


def with_time(data: Data, column: str | None, unit: str | None, rate: float | None) -> Data:
    """The data with a time column, or with a sampling rate instead."""
    proposed_changes = {
        "column": column,
        "rate": rate,
        "unit": unit if column and rate is None else None,
    }
    given = {key: value for key, value in proposed_changes.items() if value not in (None, "")}
    others = {key: value for key, value in copy.deepcopy(data).items() if key != "time"}
    return {"time": given} | others if given else others


def incomplete(data: Data, drives: Sequence[str], names: Sequence[str] | None = None) -> str:
    """What is missing before a check can begin, in the form's words; empty if nothing is.

    Args:
        drives: their names.
        names: of all columns of the recording; None if they are unknown.
    """
    for quantity in UNITS:
        if quantity not in data:
            usual = [f"{SHORT_NAMES[quantity]}{i + 1}" for i in range(len(drives))]
            if quantity in NEEDED_OF_DRIVES and names is not None and not {*usual} <= {*names}:
                return f"{quantity}: choose the column of {drives[0]}"
            continue
        for drive, entry in zip(drives, entries(data, quantity, len(drives)), strict=True):
            if "column" not in entry:
                return f"{quantity} of {drive}: choose its column"
            if fault := _unit_fault(quantity, entry):
                return f"{quantity} of {drive}: {fault}"
    if names is not None and "time" not in data and not {*TIMES} & {*names}:
        return "choose the time column, or enter the samples a second"
    return ""


def _unit_fault(quantity: Quantity, entry: Data) -> str:
    unit, constant = entry.get("unit"), entry.get("torque_constant")
    if not unit:
        return "choose its unit"
    kind = _KINDS.get(unit) or kind_of(unit)
    if quantity == "torque" and kind == "current":
        return "" if constant else f"a current in {unit} needs its N m per A"
    if kind != quantity:
        return f"{unit} is no unit of {quantity}"
    return f"{unit} is no current; clear its N m per A" if constant else ""


def difference(name: str, before: str, after: str) -> str:
    """Changes of a file as a unified diff."""
    lines = difflib.unified_diff(
        before.splitlines(), after.splitlines(), f"{name} (now)", f"{name} (then)", lineterm="", n=1
    )
    return "\n".join(lines)


def proposed_changes(verdict: Mapping[str, Any], file: str) -> list[tuple[str, object]]:
    """Changes of one file that a verdict proposes, from its JSON."""
    proposals = [proposal for proposal in verdict["proposals"] if proposal["file"] == file]
    return [(key, value) for proposal in proposals for key, value in proposal["changes"].items()]


def editable_copy(folder: Folder, robot: str) -> str:
    """The editable file of a robot; that of a catalogue robot is written into the folder.

    Raises:
        DeltaidError: it cannot be written.
    """
    if robot not in catalogue():
        return robot
    name = folder.free_name(f"{robot}.yaml")
    folder.write(name, catalogue_text(robot))
    return name
