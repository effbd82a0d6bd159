"""Which column of a log is what, and in which unit. Units are declared, never guessed."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, PrivateAttr, Tag, model_validator

from deltaid.errors import RecordingError
from deltaid.recording.address import Pick, find, listing
from deltaid.recording.source import Table
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
# Default names of the time.
TIMES = ("t", "time")
# What may be given for the unit of dates, which have none.
DATES = ("iso", "datetime")
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


class AllDrives(Part):
    """One entry for all drives, in place of a list with one a drive.

    Columns are those of one array, or are listed; of all else there is one for all, or a list.
    """

    column: Name | None = Field(
        default=None, description="array with one column a drive: column[0], column[1], …"
    )
    columns: tuple[Name, ...] | None = Field(
        default=None, description="in place of it: one column a drive"
    )
    unit: str | tuple[str, ...]
    gear: Positive | tuple[Positive, ...] = 1.0
    lead: Positive | tuple[Positive, ...] | None = None
    sign: Literal[1, -1] | tuple[Literal[1, -1], ...] = 1
    zero: float | tuple[float, ...] = 0.0
    torque_constant: Positive | tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> "AllDrives":
        if (self.column is None) == (self.columns is None):
            raise ValueError("needs either column, of an array, or columns")
        return self

    def names(self, dof: int) -> tuple[str, ...]:
        """The column of each drive."""
        return self.columns or tuple(f"{self.column}[{i}]" for i in range(dof))

    def entries(self, dof: int, where: str) -> tuple[DriveColumn, ...]:
        """The same as a list.

        Raises:
            RecordingError: a list has another length than there are drives.
        """
        given: dict[str, Any] = {key: getattr(self, key) for key in self.model_fields_set}
        given = {"columns": self.names(dof)} | given
        drives: list[dict[str, Any]] = [{} for _ in range(dof)]
        for key, value in given.items():
            if key == "column":
                continue
            if isinstance(value, tuple) and len(value) != dof:
                raise RecordingError(
                    f"lists {len(value)} {key if key == 'columns' else 'values'}, "
                    f"but the robot has {dof} drives",
                    where=where if key == "columns" else f"{where}.{key}",
                    cure="list one a drive, in order of q, or give one value for all",
                )
            for i, drive in enumerate(drives):
                name = "column" if key == "columns" else key
                drive[name] = value[i] if isinstance(value, tuple) else value
        return tuple(DriveColumn(**drive) for drive in drives)


def _spelling(value: object) -> str:
    return "all" if isinstance(value, Mapping | AllDrives) else "each"


DriveColumns = Annotated[
    Annotated[AllDrives, Tag("all")] | Annotated[tuple[DriveColumn, ...], Tag("each")],
    Discriminator(_spelling),
]


class TimeColumn(Part):
    """The time column, or what takes its place.

    A column with a unit holds times; one with a rate counts cycles; a rate alone stands for the
    time of a log without.
    """

    column: Name = "t"
    unit: str = Field(
        default="s",
        description="such as s, ms, 100 ns; dates and times of day (ISO 8601) have none",
    )
    rate: Positive | None = Field(
        default=None,
        description="samples a second, in place of a time column; or what a column counts a second",
    )

    @property
    def is_absent(self) -> bool:
        """Whether there is no column: samples follow one another at the rate."""
        return self.rate is not None and "column" not in self.model_fields_set

    @model_validator(mode="after")
    def _check(self) -> "TimeColumn":
        if self.rate is not None and "unit" in self.model_fields_set:
            raise ValueError(
                "gives unit and rate: a column of times has a unit, one that counts cycles a rate, "
                "and a log without time the rate alone"
            )
        return self


class ColumnMapping(Part):
    """The user's mapping file: columns of a log by address, drives in order of q."""

    time: TimeColumn = TimeColumn()
    position: DriveColumns | None = None
    velocity: DriveColumns | None = None
    acceleration: DriveColumns | None = None
    torque: DriveColumns | None = None
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
    def needed(self) -> tuple[tuple[str, ...], ...]:
        """Names of which a header holds one each: time, and positions of whatever robot."""
        if isinstance(self.position, AllDrives):
            names = self.position.names(1)
        else:
            names = [c.column for c in self.position or ()]
        times = (self.time.column,) if "column" in self.time.model_fields_set else TIMES
        positions = [(name,) for name in names] or [("q1", "q[0]")]
        return (*positions,) if self.time.is_absent else (times, *positions)

    @model_validator(mode="after")
    def _check(self) -> "ColumnMapping":
        if self.data_row is not None and self.data_row <= self.header_row:
            raise ValueError("data_row must come after header_row")
        return self


@dataclass(frozen=True)
class Channel:
    """One column with the affine map to SI: value = scale · (number − zero).

    Attributes:
        turn: how much the column grows in a turn of what it counts; 0 if that does not turn.
    """

    column: str
    scale: float
    zero: float
    turn: float = 0.0


@dataclass(frozen=True)
class TimeChannel(Channel):
    """The time.

    Attributes:
        is_absent: whether the log has none, so that rows, counted from 0, stand for it.
        counts: whether the column counts cycles.
    """

    is_absent: bool = False
    counts: bool = False


@dataclass(frozen=True)
class Columns:
    """Channels of a log; a quantity that the log does not have is empty."""

    time: TimeChannel
    position: tuple[Channel, ...]
    velocity: tuple[Channel, ...]
    acceleration: tuple[Channel, ...]
    torque: tuple[Channel, ...]

    @property
    def all(self) -> tuple[Channel, ...]:
        """All channels, time first."""
        drives = self.position + self.velocity + self.acceleration + self.torque
        return (self.time, *drives)

    @property
    def recorded(self) -> tuple[Channel, ...]:
        """The channels that stand in the log: all, or all but the time."""
        return self.all[1:] if self.time.is_absent else self.all


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a mapping file.

    Raises:
        DescriptionError: the file does not fit.
    """
    return load_yaml(Path(path), ColumnMapping).of(str(path))


def resolve_columns(
    table: Table, linear: tuple[bool, ...], mapping: ColumnMapping | None = None
) -> Columns:
    """Match what a log holds with a mapping, or with the default names.

    These are t (or time), and q1…, qd1…, qdd1…, tau1… or arrays q, qd, qdd, tau, in s, rad, rad/s,
    rad/s² and N m at the joint, or in m, m/s, m/s² and N. Where the mapping gives no unit, that of
    the log holds, if it states one.

    Args:
        table: the log.
        linear: for each drive whether it is a linear one.

    Raises:
        RecordingError: a column is missing, twice there or twice declared; a unit does not fit; or
            a list has the wrong length.
    """
    mapping = mapping or ColumnMapping()
    time = _time(table, mapping)
    channels = {
        quantity: _declared(quantity, linear, given, mapping.source)
        if (given := getattr(mapping, quantity)) is not None
        else _under_default_names(quantity, table, linear)
        for quantity in QUANTITIES
    }
    columns = Columns(time, **channels)
    names = [channel.column for channel in columns.recorded]
    if not columns.position:
        names += _default_names("position", len(linear))
    _require_once(names, table, mapping.source)
    _require_no_dates(table.picks(names)[not time.is_absent :], str(table.path))
    return columns


def si_unit(quantity: Quantity, *, linear: bool) -> str:
    """The unit that a column has if none is declared, of a drive that slides or turns."""
    return (_SLIDING if linear else _TURNING)[quantity]


def extra_drives(table: Table, columns: Columns, dof: int) -> list[str]:
    """Columns with default names of a drive that the robot does not have."""
    used = {channel.column for channel in columns.all}
    names = [f"{_SHORT[quantity]}{dof + 1}" for quantity in QUANTITIES]
    found = [name for name in names if name in table.header and name not in used]
    arrays = [f"{short}[{dof}]" for short in _SHORT.values() if f"{short}[0]" in used]
    return found + [name for name in arrays if _is_there(table, columns.time.column, name)]


def _is_there(table: Table, *names: str) -> bool:
    try:
        table.picks(names)
    except RecordingError:
        return False
    return True


def _time(table: Table, mapping: ColumnMapping) -> TimeChannel:
    name, unit, place = mapping.time.column, mapping.time.unit, f"{mapping.source}, time.unit"
    declared, rate = mapping.time.model_fields_set, mapping.time.rate
    if rate is not None and mapping.time.is_absent:
        return TimeChannel("time", 1 / rate, 0.0, is_absent=True)
    if "column" not in declared:
        name = next((one for one in TIMES if find(table.fields, one)), name)
    found = find(table.fields, name)
    positions = (any(find(table.fields, one) for one in names) for names in mapping.needed[1:])
    if found is None and "column" not in declared and all(positions):
        raise RecordingError(
            f"has no time: no column {' or '.join(TIMES)}; its columns are {listing(table.fields)}",
            where=table.header_place,
            cure="name its column in a mapping (--columns MAPPING.yaml) by the line "
            "`time: {column: NAME, unit: s}`, or if there is none, give the sampling rate by the "
            "line `time: {rate: 1000}`",
        )
    is_date = found is not None and found[0].is_clock
    if is_date and (rate is not None or ("unit" in declared and unit not in ("s", *DATES))):
        raise RecordingError(
            f"column {name} holds dates or times of day, which have no unit and no rate",
            where=f"{mapping.source}, time",
            cure="leave the unit of time and the rate out",
        )
    if rate is not None:
        return TimeChannel(name, 1 / rate, 0.0, counts=True)
    if unit in DATES:
        return TimeChannel(name, 1.0, 0.0)
    if "unit" not in declared and name in table.units:
        place, unit = f"{table.header_place}, unit of {name}", table.units[name]
    return TimeChannel(name, si_factor(unit, "s", where=place), 0.0)


def _default_names(quantity: Quantity, dof: int) -> list[str]:
    return [f"{_SHORT[quantity]}{i + 1}" for i in range(dof)]


def _under_default_names(
    quantity: Quantity, table: Table, linear: tuple[bool, ...]
) -> tuple[Channel, ...]:
    names, short = _default_names(quantity, len(linear)), _SHORT[quantity]
    if not any(name in table.header for name in names):
        array = find(table.fields, short)
        if not (find(table.fields, f"{short}[0]") and (not array or len(array[0].shape) > 1)):
            return ()
        names = [f"{short}[{i}]" for i in range(len(linear))]
    # Some but not all: keep them all, so that the missing ones are named.
    targets = [si_unit(quantity, linear=slides) for slides in linear]
    where, units = table.header_place, table.units
    scales = [
        si_factor(units.get(name, si), si, where=f"{where}, unit of {name}")
        for name, si in zip(names, targets, strict=True)
    ]
    return tuple(
        Channel(name, scale, 0.0, turn=2 * math.pi / scale if si == "rad" else 0.0)
        for name, scale, si in zip(names, scales, targets, strict=True)
    )


def _declared(
    quantity: Quantity,
    linear: tuple[bool, ...],
    given: AllDrives | tuple[DriveColumn, ...],
    source: str,
) -> tuple[Channel, ...]:
    dof = len(linear)
    if isinstance(given, AllDrives):
        given = given.entries(dof, f"{source}, {quantity}")
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
    unit = si_factor(column.unit, target, where=where, torque_constant=column.torque_constant)
    travel = column.lead / (2 * math.pi) if column.lead is not None else 1.0
    factor = unit * (column.gear / travel if quantity == "torque" else travel / column.gear)
    if not 0 < factor < math.inf:
        raise RecordingError(
            f"unit and gear together make a factor of {factor:g}, which is no number to go on with",
            where=where,
            cure="check unit, gear and torque_constant; gear is motor revolutions per joint's",
        )
    turn = 2 * math.pi / unit if target == "rad" else 0.0
    return Channel(column.column, column.sign * factor, column.zero, turn)


def _require_no_dates(picks: list[Pick], where: str) -> None:
    for pick in picks:
        if pick.field.is_clock:
            raise RecordingError(
                f"column {pick.field.name} holds dates or times of day, which no drive measures",
                where=where,
                cure="map another column",
            )


def _require_once(names: list[str], table: Table, source: str) -> None:
    for name in names:
        if table.header.count(name) > 1:
            raise RecordingError(
                f"has {table.header.count(name)} columns called {name}",
                where=table.header_place,
                cure="rename one",
            )
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise RecordingError(
            f"column {name} is declared {count} times",
            where=source,
            cure="give every drive and every quantity a column of its own",
        )
