"""Proposes a mapping for a recording without default names, by names, units in names, and numbers.

Each quantity has reasons and doubts. Without a mapping, a proposal is used only if it has no
doubts; any other is shown, and the user may write it to a file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from deltaid.recording.address import RecordedField
from deltaid.recording.column_meanings import QUANTITIES as WORDS
from deltaid.recording.column_meanings import Group, Reading, groups_of, kind_of, read_name, unit_of
from deltaid.recording.mapped_columns import NEEDED, QUANTITIES, SHORT_NAMES, Quantity
from deltaid.recording.mapping import FoundColumns, Known, MappingProposal
from deltaid.recording.units import (
    SI_UNITS,
    Signal,
    derivative_factor,
    fitting_units,
    si_factor,
    time_unit,
)

# Largest position of a carriage [m]: numbers in millimetres mostly exceed it.
MOST_METRES = 10.0
# Largest position of an arm is one turn [rad]: numbers in degrees mostly exceed it.
_DEGREES = ("deg", 2 * np.pi, "degrees")
# Largest number of drives of a parallel robot.
_MOST_DRIVES = 8
# Most columns of one array: the time and all quantities of all drives; wider ones are images.
_WIDEST = 1 + len(QUANTITIES) * _MOST_DRIVES
_RATES = {"velocity": "/s", "acceleration": "/s^2"}


@dataclass(frozen=True)
class Column:
    """One column of a recording.

    Attributes:
        address: name of the column in a mapping.
        unit: unit as the file states it; empty if it states none.
        low, high: range of the numbers; None if unknown.
        is_date: whether the column holds dates.
        start: first numbers; None if unknown.
    """

    address: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    is_date: bool = False
    start: Signal | None = field(default=None, compare=False, repr=False)

    @property
    def is_constant(self) -> bool:
        return self.low is not None and self.low == self.high


def addresses(fields: Sequence[RecordedField], units: Mapping[str, str]) -> list[Column]:
    """All columns that a mapping may name, including each column of an array."""
    columns: list[Column] = []
    for entry in fields:
        if entry.holds:
            continue
        unit = units.get(entry.name, "")
        wide = [size for size in entry.shape if size is not None and 1 < size <= _WIDEST]
        if len(entry.shape) > 1 and wide:
            names = [f"{entry.name}[{i}]" for i in range(wide[-1])]
            columns += [Column(name, units.get(name, unit)) for name in names]
        elif entry.shape:
            columns.append(Column(entry.name, unit, is_date=entry.is_clock))
    return columns


def count_drives(columns: Sequence[Column]) -> int:
    """Number of drives of the largest group of positions, else of torques; three without any."""
    names = [column.address for column in columns]
    for quantity in ("position", "torque"):
        for drives in range(_MOST_DRIVES, 0, -1):
            readings = (read_name(names[group.places[0]]) for group in groups_of(names, drives))
            if any(reading.is_usable and reading.quantity == quantity for reading in readings):
                return drives
    return 3


def proposed_mapping(
    columns: Sequence[Column], linear: Sequence[bool], known: Known | None = None
) -> MappingProposal:
    """Propose a mapping by names, units and numbers.

    Args:
        columns: columns of the recording in order.
        linear: whether each drive slides.
        known: units, gear and torque constant that the user states.
    """
    known, candidates = known or Known(), _candidates(columns, len(linear))
    proposed = [time] if (time := _time(columns, known)) else []
    proposed += [_drives(q, candidates[q], linear, known) for q in QUANTITIES if candidates[q]]
    parts = {part.quantity: part for part in proposed}
    _settle_units(parts, columns, linear)
    missing = [name for name in NEEDED if name not in parts]
    missing += [
        f"unit of {name}" for name in NEEDED if name in parts and not all(parts[name].units)
    ]
    if known.torque_constant is None and any(
        kind_of(unit) == "current" for unit in (parts["torque"].units if "torque" in parts else ())
    ):
        missing.append("torque_constant")
    # Velocities and accelerations without a unit are dropped: they follow from positions.
    parts = {name: part for name, part in parts.items() if name in NEEDED or all(part.units)}
    data = {name: _entries(part, columns, known) for name, part in parts.items()}
    return MappingProposal(data, tuple(parts.values()), tuple(missing))


def _candidates(
    columns: Sequence[Column], drives: int
) -> dict[str, list[tuple[Reading, Group, list[Column]]]]:
    by_quantity: dict[str, list[tuple[Reading, Group, list[Column]]]] = {q: [] for q in QUANTITIES}
    for group in groups_of([column.address for column in columns], drives):
        members = [columns[place] for place in group.places]
        reading = read_name(members[0].address)
        quantity = "torque" if reading.quantity == "current" else reading.quantity
        candidates = by_quantity.get(quantity, [])
        is_new = not any(members == others for _, _, others in candidates)
        if reading.is_usable and is_new:
            candidates.append((reading, group, members))
    for candidates in by_quantity.values():
        candidates.sort(key=lambda c: (not _are_constant(c[2]), c[0].rank), reverse=True)
    return by_quantity


def _are_constant(columns: Sequence[Column]) -> bool:
    return all(column.is_constant for column in columns)


def _time(columns: Sequence[Column], known: Known) -> FoundColumns | None:
    """Time: a column with a name for it and growing numbers, in the unit that fits its steps."""
    readings = [(column, read_name(column.address)) for column in columns]
    named = [
        (column, reading)
        for column, reading in readings
        if reading.quantity == "time" and reading.is_usable and time_unit(column.start) is not None
    ]
    # Plain names first, then names with a word for time, then with a unit of time alone.
    words = WORDS["time"]
    named.sort(
        key=lambda p: (not words.issuperset(p[1].words), not words & {*p[1].words}, not p[1].unit)
    )
    if not named:
        return None
    (column, reading), *others = named
    is_plain = words.issuperset(reading.words)
    rivals = [c for c, r in others if words.issuperset(r.words) or not is_plain]
    doubts, names = [f"{c.address} may be the time as well" for c in rivals], (column.address,)
    if column.is_date:
        return FoundColumns("time", names, ("s",), ("it holds dates or times of day",), (*doubts,))
    unit, reason = _stated("time", column, reading, known)
    if unit is None and (unit := time_unit(column.start) or None):
        reason = f"its usual step can be in {unit} only"
    assumed = "seconds are assumed, for no unit is stated" if unit is None else ""
    reasons = ("by its name", reason) if reason else ("by its name",)
    units = ("s" if unit is None else unit,)
    return FoundColumns("time", names, units, reasons, tuple(doubts), assumed)


def _drives(
    quantity: Quantity,
    candidates: Sequence[tuple[Reading, Group, list[Column]]],
    linear: Sequence[bool],
    known: Known,
) -> FoundColumns:
    (reading, group, members), *others = candidates
    by = f"{reading.documented} is a drive's signal" if reading.documented else "by their names"
    reasons, unsure = [by], list[str]()
    for other, _, columns in others:
        is_rival = _are_constant(columns) == _are_constant(members)
        if is_rival and other.rank[:2] == reading.rank[:2]:
            unsure.append(f"{columns[0].address} and so on may be it as well")
        else:
            reasons.append(f"rather than {columns[0].address}")
    if _are_constant(members):
        unsure.append("they do not change, as nothing that is measured does")
    if group.axes > len(members):
        unsure.append(f"there are {group.axes} of them, and the first {len(members)} are taken")
    if group.by_letter:
        unsure.append("letters may be directions in space and no drives")
    units, assumed = list[str](), ""
    short, names = SHORT_NAMES[quantity], tuple(column.address for column in members)
    is_default = any(
        names == tuple(form.format(short, first + i) for i in range(len(names)))
        for form, first in (("{}{}", 1), ("{}[{}]", 0))
    )
    for column, slides in zip(members, linear, strict=True):
        unit, reason = _stated(quantity, column, read_name(column.address), known)
        if unit is None:
            unit, assumed = _by_size(
                quantity, reading, members, slides=slides, is_default=is_default
            )
            reason = "" if assumed else f"{unit} is what default names are in"
        elif not unit:
            reason = "their unit depends on a rated value or an encoder, which no log states"
        units.append(unit)
        if reason and reason not in reasons:
            reasons.append(reason)
    if reading.quantity == "current" and known.torque_constant is None:
        reasons.append("a current needs its torque constant")
    return FoundColumns(quantity, names, tuple(units), tuple(reasons), tuple(unsure), assumed)


def _stated(
    quantity: str, column: Column, reading: Reading, known: Known
) -> tuple[str | None, str]:
    if quantity in known.units:
        return known.units[quantity], f"{known.units[quantity]} is given"
    if column.unit:
        return unit_of(column.unit) or "", f"{column.unit} is stated in the file"
    if reading.unit and reading.documented:
        return reading.unit, f"{reading.unit} by its documentation"
    return reading.unit, f"{reading.unit} stands in the name" if reading.unit else ""


def _by_size(
    quantity: Quantity,
    reading: Reading,
    members: Sequence[Column],
    *,
    slides: bool,
    is_default: bool,
) -> tuple[str, str]:
    """Unit to assume if none is stated, and the doubt, which is empty for default names."""
    ends = [max(abs(column.low or 0.0), abs(column.high or 0.0)) for column in members]
    # With default names, the drive of a telescope may turn several times, but the arms do not.
    largest = min(ends) if is_default else max(ends)
    if reading.quantity == "current":
        return "A", "ampere are assumed, for no unit is stated"
    si = SI_UNITS[quantity][slides]
    unit, most, words = ("mm", MOST_METRES, "millimetres") if slides else _DEGREES
    if quantity == "position" and largest > most:
        seen = f"numbers go up to {largest:.3g}"
        if _are_whole(members) and largest > most / si_factor(unit, si, where=unit):
            return "", f"{seen} and are whole, as counts of an encoder are"
        return unit, f"{seen}, so {words} are assumed"
    if quantity == "torque" and _are_whole(members):
        why = "though all numbers are whole, as per mille of a rated torque are"
        return si, f"{si} is assumed, {why}"
    return si, "" if is_default else f"{si} is assumed, for no unit is stated"


def _are_whole(columns: Sequence[Column]) -> bool:
    """Whether the first numbers of all columns are whole, and some of them change."""
    starts = [column.start for column in columns if column.start is not None]
    whole = all(np.array_equal(start, np.round(start), equal_nan=True) for start in starts)
    return whole and bool(starts) and not _are_constant(columns)


def _settle_units(
    parts: dict[str, FoundColumns], columns: Sequence[Column], linear: Sequence[bool]
) -> None:
    """Settle units by the fact that velocities are the derivatives of positions."""
    by_name = {column.address: column for column in columns}
    time, place = parts.get("time"), parts.get("position")
    for quantity, per in _RATES.items():
        if place and place.unit in ("deg", "mm") and quantity in parts and parts[quantity].assumed:
            why = f"{place.unit}{per} is assumed, as positions are"
            units = (place.unit + per,) * len(linear)
            parts[quantity] = replace(parts[quantity], units=units, assumed=why)
    rate = parts.get("velocity")
    if not (time and place and rate and time.unit and place.unit and rate.unit):
        return
    signals = [[by_name[name].start for name in part.columns] for part in (place, rate)]
    clock, units = by_name[time.columns[0]].start, (place.unit, rate.unit, time.unit)
    if clock is None or (factor := derivative_factor(clock, *signals)) is None:
        return
    unknown = [part for part in (place, rate, time) if part.assumed]
    if len(unknown) == 1:
        fitting = fitting_units(factor, units, unknown[0].quantity, slides=linear[0])
        if len(fitting) == 1:
            why = (
                f"{fitting[0]} follows from the rest, as velocities are the positions' derivatives"
            )
            part, reasons = unknown[0], (*unknown[0].reasons, why)
            found_units = (fitting[0],) * len(part.units)
            parts[part.quantity] = replace(part, units=found_units, reasons=reasons, assumed="")
    elif not unknown and not fitting_units(factor, units, ""):
        doubt = (
            f"the positions' derivative is {factor:.4g} times these numbers, which does not fit "
            "the units; is one of them at the motor, behind a gear?"
        )
        parts["velocity"] = replace(rate, doubts=(*rate.doubts, doubt))


def _entries(part: FoundColumns, columns: Sequence[Column], known: Known) -> Any:
    """Entries of a quantity in a mapping file: one per drive, or one for the time."""

    def entry(name: str, unit: str, **of_motor: float | None) -> dict[str, Any]:
        given = {"column": name, "unit": unit or None, **of_motor}
        return {key: value for key, value in given.items() if value is not None}

    pairs = zip(part.columns, part.units, strict=True)
    if part.quantity == "time":
        dates = {column.address for column in columns if column.is_date}
        ((name, unit),) = pairs
        return entry(name, "" if name in dates else unit)
    constants = {"current": known.torque_constant}
    return [
        entry(name, unit, gear=known.gear, torque_constant=constants.get(unit and kind_of(unit)))
        for name, unit in pairs
    ]
