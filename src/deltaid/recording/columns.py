"""Which column of a log is what, and in which unit. Units are declared, never guessed."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from deltaid.errors import RecordingError
from deltaid.recording.units import si_factor
from deltaid.robot.load import load_yaml
from deltaid.robot.part import Part
from deltaid.robot.quantities import Positive


def _numbered(value: object) -> object:
    """A column's number as the name that it has in a log without header."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Name = Annotated[
    str,
    BeforeValidator(_numbered, json_schema_input_type=str | int),
    Field(min_length=1, description="as in the log's header; its number from 1 if there is none"),
]
Quantity = Literal["position", "velocity", "acceleration", "torque"]
QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "torque")
_SHORT = {"position": "q", "velocity": "qd", "acceleration": "qdd", "torque": "tau"}
_TURNING = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "torque": "N m"}
_SLIDING = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2", "torque": "N"}


class DriveColumn(Part):
    """One column of one drive, and how its numbers become SI at the robot's joint.

    joint value = sign · unit · (number − zero) / gear for motion, and
    joint torque = sign · unit · torque_constant · (number − zero) · gear for torque. With a `lead`
    the unit is one of the turning motor, and a revolution of it moves a linear drive that far.
    """

    column: Name
    unit: str = Field(
        description="such as deg, rpm, mN*m, or A with a torque_constant; a number may stand "
        "before it, such as 0.0235 N*m for per mille of 23.5 N m"
    )
    gear: Positive = Field(default=1.0, description="motor revolutions per joint revolution")
    lead: Positive | None = Field(
        default=None,
        description="m per revolution of spindle or belt pulley, for a linear drive whose column "
        "is of the motor",
    )
    sign: Literal[1, -1] = Field(default=1, description="-1 if the column counts the other way")
    zero: float = Field(default=0.0, description="the column's number where the joint value is 0")
    torque_constant: Positive | None = Field(
        default=None, description="N m per A at the motor, for torque columns in ampere"
    )


class TimeColumn(Part):
    """The time column."""

    column: Name = "t"
    unit: str = "s"


class ColumnMapping(Part):
    """The user's mapping file: columns of a log by name, one entry a drive in order of q."""

    time: TimeColumn = TimeColumn()
    position: tuple[DriveColumn, ...] | None = None
    velocity: tuple[DriveColumn, ...] | None = None
    acceleration: tuple[DriveColumn, ...] | None = None
    torque: tuple[DriveColumn, ...] | None = None
    header_row: Annotated[int, Field(ge=1)] = Field(
        default=1,
        description="line of a CSV file of the column names; searched if neither row is given",
    )
    data_row: int | None = Field(
        default=None,
        description="line of a CSV file that holds the first numbers; after header_row by default",
    )
    _source: str = PrivateAttr("column mapping")

    @property
    def source(self) -> str:
        """The file it comes from, for messages."""
        return self._source

    def of(self, source: str) -> "ColumnMapping":
        """The same, known by the file that it comes from."""
        mapping = self.model_copy()
        mapping._source = source
        return mapping

    @property
    def needed(self) -> tuple[str, ...]:
        """Names without which a row is no header: time, and positions of whatever robot."""
        positions = self.position or ()
        return (self.time.column, *([c.column for c in positions] or ["q1"]))

    @model_validator(mode="after")
    def _check(self) -> "ColumnMapping":
        if self.data_row is not None and self.data_row <= self.header_row:
            raise ValueError("data_row must come after header_row")
        return self


@dataclass(frozen=True)
class Channel:
    """One column with the affine map to SI: value = scale · (number − zero)."""

    column: str
    scale: float
    zero: float


@dataclass(frozen=True)
class Columns:
    """Channels of a log; a quantity that the log does not have is empty."""

    time: Channel
    position: tuple[Channel, ...]
    velocity: tuple[Channel, ...]
    acceleration: tuple[Channel, ...]
    torque: tuple[Channel, ...]

    @property
    def all(self) -> tuple[Channel, ...]:
        """All channels, time first."""
        drives = self.position + self.velocity + self.acceleration + self.torque
        return (self.time, *drives)


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a mapping file.

    Raises:
        DescriptionError: the file does not fit.
    """
    return load_yaml(Path(path), ColumnMapping).of(str(path))


def resolve_columns(
    header: tuple[str, ...],
    linear: tuple[bool, ...],
    mapping: ColumnMapping | None,
    *,
    where: str,
    units: Mapping[str, str] | None = None,
) -> Columns:
    """Match a log's header with a mapping, or with the default names t, q1…, qd1…, qdd1…, tau1….

    The default names are in s, rad, rad/s, rad/s² and N m at the joint, or in m, m/s, m/s² and N.

    Args:
        linear: for each drive whether it is a linear one.
        units: of columns as the log states them, for those of which the mapping says nothing.

    Raises:
        RecordingError: a column is missing, twice there or twice declared; a unit does not fit; or
            a list has the wrong length.
    """
    mapping = mapping or ColumnMapping()
    units = units or {}
    place, unit = f"{mapping.source}, time.unit", mapping.time.unit
    if "unit" not in mapping.time.model_fields_set and mapping.time.column in units:
        place, unit = f"{where}, unit of {mapping.time.column}", units[mapping.time.column]
    time = Channel(mapping.time.column, si_factor(unit, "s", where=place), 0.0)
    channels = {
        quantity: _declared(quantity, linear, given, mapping.source)
        if (given := getattr(mapping, quantity)) is not None
        else _under_default_names(quantity, header, linear, units, where)
        for quantity in QUANTITIES
    }
    columns = Columns(time, **channels)
    names = [channel.column for channel in columns.all]
    if not columns.position:
        names += _default_names("position", len(linear))
    _require_once(names, header, where, mapping.source)
    _require_present(names, header, where)
    return columns


def si_unit(quantity: Quantity, *, linear: bool) -> str:
    """The unit that a column has if none is declared, of a drive that slides or turns."""
    return (_SLIDING if linear else _TURNING)[quantity]


def extra_drives(header: tuple[str, ...], columns: Columns, dof: int) -> list[str]:
    """Columns with default names of a drive that the robot does not have."""
    used = {channel.column for channel in columns.all}
    names = [f"{_SHORT[quantity]}{dof + 1}" for quantity in QUANTITIES]
    return [name for name in names if name in header and name not in used]


def listing(names: tuple[str, ...]) -> str:
    """Column names for a message, shortened where they are many or long."""
    shown = [name if len(name) <= 40 else f"{name[:37]}…" for name in names[:20]]
    more = f" and {len(names) - 20} more" if len(names) > 20 else ""
    return ", ".join(shown) + more


def _default_names(quantity: Quantity, dof: int) -> list[str]:
    return [f"{_SHORT[quantity]}{i + 1}" for i in range(dof)]


def _under_default_names(
    quantity: Quantity,
    header: tuple[str, ...],
    linear: tuple[bool, ...],
    units: Mapping[str, str],
    where: str,
) -> tuple[Channel, ...]:
    names = _default_names(quantity, len(linear))
    if not any(name in header for name in names):
        return ()
    # Some but not all: keep them all, so that the missing ones are named.
    targets = [si_unit(quantity, linear=slides) for slides in linear]
    return tuple(
        Channel(name, si_factor(units.get(name, si), si, where=f"{where}, unit of {name}"), 0.0)
        for name, si in zip(names, targets, strict=True)
    )


def _declared(
    quantity: Quantity, linear: tuple[bool, ...], given: tuple[DriveColumn, ...], source: str
) -> tuple[Channel, ...]:
    dof = len(linear)
    if len(given) != dof:
        raise RecordingError(
            f"lists {len(given)} columns, but the robot has {dof} drives",
            where=f"{source}, {quantity}",
            cure="list one column a drive, in order of q, or leave the list out",
        )
    return tuple(
        _channel(quantity, column, slides, f"{source}, {quantity}[{i}]")
        for i, (column, slides) in enumerate(zip(given, linear, strict=True))
    )


def _channel(quantity: Quantity, column: DriveColumn, linear: bool, where: str) -> Channel:
    if quantity != "torque" and column.torque_constant is not None:
        raise RecordingError(
            "belongs to torque columns only",
            where=f"{where}.torque_constant",
            cure="leave it out",
        )
    if column.lead is not None and not linear:
        raise RecordingError(
            "belongs to linear drives only", where=f"{where}.lead", cure="leave it out"
        )
    motor = not linear or column.lead is not None
    target = (_TURNING if motor else _SLIDING)[quantity]
    factor = si_factor(column.unit, target, where=where, torque_constant=column.torque_constant)
    travel = column.lead / (2 * math.pi) if column.lead is not None else 1.0
    factor *= column.gear / travel if quantity == "torque" else travel / column.gear
    if not 0 < factor < math.inf:
        raise RecordingError(
            f"unit and gear together make a factor of {factor:g}, which is no number to go on with",
            where=where,
            cure="check unit, gear and torque_constant; gear is motor revolutions per joint's",
        )
    return Channel(column.column, column.sign * factor, column.zero)


def _require_present(names: list[str], header: tuple[str, ...], where: str) -> None:
    missing = [name for name in names if name not in header]
    if not missing:
        return
    cure = (
        "rename the columns to t, q1…, tau1… (and qd1…, qdd1… if recorded), or say which is which "
        "with --columns MAPPING.yaml, and in which row (header_row) the names are"
    )
    if len(header) == 1:
        cure = "separate the columns by comma, semicolon, tab or blanks"
    raise RecordingError(
        f"has no column {', '.join(missing)}; its columns are {listing(header)}",
        where=where,
        cure=cure,
    )


def _require_once(names: list[str], header: tuple[str, ...], where: str, source: str) -> None:
    for name in names:
        if header.count(name) > 1:
            raise RecordingError(
                f"has {header.count(name)} columns called {name}", where=where, cure="rename one"
            )
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise RecordingError(
            f"column {name} is declared {count} times",
            where=source,
            cure="give every drive and every quantity a column of its own",
        )
