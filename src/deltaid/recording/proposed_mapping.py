"""Which column of a foreign recording may be what: proposals by names, units and sizes.

A proposal is never used unasked: it is shown with its reasons, and a mapping file is written when
the user takes it. What names do not tell stays open.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltaid.files import written_whole
from deltaid.recording.address import Field
from deltaid.recording.mapping import QUANTITIES, ColumnMapping, Quantity
from deltaid.recording.resolution import si_unit
from deltaid.recording.units import is_unit
from deltaid.robot.load import yaml_text

# A carriage hardly travels 10 m; numbers of millimetres mostly exceed that.
_MOST_METRES = 10.0
# A drive that turns hardly leaves ±2 π; numbers of degrees mostly do.
_MOST_RADIANS = 7.0
# Numbers of an array beside each other that may be a column each; what is wider is an image.
_WIDEST = 16
# Words of names, in small letters, that stand for a quantity; the first that fits counts.
_WORDS: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "timestamp", "zeit", "stamp", "clock", "sec", "millis", "ticks"),
    "acceleration": ("acc", "accel", "acceleration", "qdd", "ddq", "beschleunigung"),
    "velocity": ("vel", "velocity", "speed", "qd", "dq", "omega", "drehzahl", "geschwindigkeit"),
    "torque": (
        "tau", "torque", "trq", "tq", "moment", "drehmoment", "current", "cur", "strom", "iq",
        "effort", "force", "kraft",
    ),
    "position": (
        "q", "pos", "position", "angle", "ang", "theta", "joint", "enc", "encoder", "winkel", "phi",
    ),
}  # fmt: skip
# Words of what was asked for and not measured, or is no quantity of a drive itself.
_ASKED = (
    "set", "setpoint", "cmd", "command", "commanded", "ref", "reference", "target", "desired",
    "des", "soll", "demand", "err", "error", "lag", "following", "limit", "max", "min", "ff",
    "feedforward", "tcp", "tool", "platform", "cartesian",
)  # fmt: skip
_ACTUAL = ("act", "actual", "meas", "measured", "ist", "fb", "feedback")
_CURRENTS = ("current", "cur", "strom", "iq", "amp", "amps")
_UNIT_WORDS = {
    "deg": "deg", "degree": "deg", "degrees": "deg", "rad": "rad", "rads": "rad/s", "rpm": "rpm",
    "mm": "mm", "ms": "ms", "us": "us", "ns": "ns", "s": "s", "nm": "N m", "mnm": "mN*m",
    "ma": "mA", "a": "A", "rev": "rev", "turns": "rev",
}  # fmt: skip
_RATES = {"velocity": "/s", "acceleration": "/s^2"}
# Drives that a parallel robot has at most.
_MOST_DRIVES = 8
_SPLIT = re.compile(r"[^A-Za-zµ%]+|(?<=[a-zµ])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class Column:
    """One column of a recording, as far as it is known without its rows.

    Attributes:
        address: its name, as a mapping names it.
        unit: as the file states it; empty if it does not.
        low, high: of its numbers; None as long as they are not known.
        is_date: whether it holds dates.
    """

    address: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    is_date: bool = False

    @property
    def largest(self) -> float:
        """Of its numbers without sign; 0 as long as they are not known."""
        return max(abs(self.low or 0.0), abs(self.high or 0.0))


@dataclass(frozen=True)
class MappingProposal:
    """A mapping that may be right.

    Attributes:
        data: as its file would hold it.
        reasons: why, one sentence each; what is assumed says so.
        missing: quantities that are needed and were not found.
    """

    data: dict[str, Any]
    reasons: tuple[str, ...]
    missing: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether a check can begin with it."""
        return not self.missing

    @property
    def mapping(self) -> ColumnMapping:
        """The same as a value, to be given as `columns=`.

        Raises:
            DescriptionError: quantities that are needed were not found.
        """
        return ColumnMapping.from_dict(self.data, "proposed columns").known_as("proposed columns")

    def save(self, path: str | Path) -> None:
        """Write it as a mapping file, to be read and corrected.

        Raises:
            DeltaidError: the file cannot be written.
        """
        with written_whole(Path(path)) as file:
            file.write(yaml_text(self.data))


def addresses(fields: Sequence[Field], units: Mapping[str, str]) -> list[Column]:
    """All columns that a mapping may name; of a short array each one."""
    found: list[Column] = []
    for field in fields:
        if field.holds:
            continue
        unit = units.get(field.name, "")
        wide = [size for size in field.shape if size is not None and 1 < size <= _WIDEST]
        if len(field.shape) > 1 and wide:
            names = [f"{field.name}[{i}]" for i in range(wide[-1])]
            found += [Column(name, units.get(name, unit)) for name in names]
        elif field.shape:
            found.append(Column(field.name, unit, is_date=field.is_clock))
    return found


def count_drives(columns: Sequence[Column]) -> int:
    """How many drives the largest group of positions has; three where there is none."""
    for drives in range(_MOST_DRIVES, 0, -1):
        groups = _groups(columns, drives)
        if any(_quantity(group[0].address) == "position" for group in groups):
            return drives
    return 3


def proposed_mapping(columns: Sequence[Column], linear: Sequence[bool]) -> MappingProposal:
    """The mapping that names, units and sizes speak for.

    Args:
        columns: of the recording, in its order.
        linear: for each drive whether it slides.
    """
    data: dict[str, Any] = {}
    reasons: list[str] = []
    time = next((column for column in columns if _quantity(column.address) == "time"), None)
    if time is not None:
        data["time"], reason = _time(time)
        reasons.append(reason)
    groups = list(_groups(columns, len(linear)))
    for quantity in QUANTITIES:
        fitting = [group for group in groups if _quantity(group[0].address) == quantity]
        if not fitting:
            continue
        best = max(fitting, key=lambda group: _rank(group[0].address))
        entries, unit_reason = _entries(quantity, best, linear, data)
        data[quantity] = entries
        others = f", rather than {fitting[0][0].address}" if fitting[0] is not best else ""
        names = ", ".join(column.address for column in best)
        reasons.append(f"{quantity}: {names} by their names{others}; {unit_reason}")
    needed = (("time", time is not None), *((q, q in data) for q in ("position", "torque")))
    return MappingProposal(data, tuple(reasons), tuple(name for name, there in needed if not there))


def words_of(name: str) -> list[str]:
    """'Axis1.ActPos[deg]' as ['axis', 'act', 'pos', 'deg']."""
    return [word.lower() for word in _SPLIT.split(name) if word]


def _quantity(name: str) -> str:
    """What a column's name stands for; empty if nothing, or if it is asked for and not measured."""
    words = words_of(_IN_BRACKETS.sub("", name))
    if any(word in _ASKED for word in words) and not any(word in _ACTUAL for word in words):
        return ""
    for quantity, known in _WORDS.items():
        if any(word in known for word in words):
            return quantity
    return ""


def _rank(name: str) -> tuple[bool, int]:
    """Measured ones first, then plain names."""
    words = words_of(name)
    return any(word in _ACTUAL for word in words), -len(words)


def _groups(columns: Sequence[Column], dof: int) -> Iterator[list[Column]]:
    """Columns whose names differ in column number only, as many as there are drives."""
    found: dict[tuple[str, int], dict[int, Column]] = {}
    for column in columns:
        plain = (
            _IN_BRACKETS.sub("", column.address)
            if column.address[-1:] not in "]"
            else column.address
        )
        for match in _NUMBER.finditer(plain):
            stem = f"{plain[: match.start()]}#{plain[match.end() :]}"
            found.setdefault((stem, match.start()), {})[int(match[0])] = column
    for numbered in found.values():
        first = min(numbered)
        run = [n for n in range(first, first + dof) if n in numbered]
        if first <= 1 and len(run) == dof:
            yield [numbered[n] for n in run]


def _time(column: Column) -> tuple[dict[str, Any], str]:
    if column.is_date:
        return {"column": column.address}, f"time: {column.address} holds dates or times of day"
    unit, reason = _stated(column)
    if not unit:
        unit, reason = "s", "seconds are assumed"
    return {"column": column.address, "unit": unit}, f"time: {column.address}; {reason}"


def _entries(
    quantity: Quantity, group: Sequence[Column], linear: Sequence[bool], known: dict[str, Any]
) -> tuple[list[dict[str, Any]], str]:
    """An entry a drive, and why it has its unit."""
    entries: list[dict[str, Any]] = []
    reason = ""
    for column, slides in zip(group, linear, strict=True):
        unit, why = _stated(column)
        if not unit:
            unit, why = _by_size(quantity, group, slides=slides)
            place = known.get("position", [])
            if quantity in _RATES and place and place[0]["unit"] in ("deg", "mm"):
                unit = place[0]["unit"] + _RATES[quantity]
                why = f"{unit} is assumed, as positions are"
        entries.append({"column": column.address, "unit": unit})
        reason = reason or why
    return entries, reason


def _stated(column: Column) -> tuple[str, str]:
    """The unit that the file or the name states."""
    if column.unit:
        return column.unit, f"{column.unit} is stated in the file"
    bracket = _IN_BRACKETS.search(column.address)
    if bracket and not bracket[1].isdigit() and is_unit(bracket[1]):
        return bracket[1], f"{bracket[1]} stands in the name"
    last = words_of(column.address)[-1:]
    if last and last[0] in _UNIT_WORDS and len(words_of(column.address)) > 1:
        unit = _UNIT_WORDS[last[0]]
        return unit, f"{unit} by the name"
    return "", ""


def _by_size(quantity: Quantity, group: Sequence[Column], *, slides: bool) -> tuple[str, str]:
    """The unit that is assumed where none is stated."""
    largest = max(column.largest for column in group)
    names = {word for column in group for word in words_of(column.address)}
    if quantity == "torque" and names & set(_CURRENTS):
        return "A", "a current by the name: A is assumed, and the torque constant is to be given"
    if quantity == "position" and not slides and largest > _MOST_RADIANS:
        return "deg", f"numbers go up to {largest:.3g}, so degrees are assumed"
    if quantity == "position" and slides and largest > _MOST_METRES:
        return "mm", f"numbers go up to {largest:.3g}, so millimetres are assumed"
    unit = si_unit(quantity, linear=slides)
    return unit, f"{unit} is assumed, for no unit is stated"
