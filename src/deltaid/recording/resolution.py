"""Resolves the columns of a table by the user's mapping or by default names."""

import math
from collections import Counter
from collections.abc import Mapping
from itertools import chain, count, takewhile

from deltaid.errors import RecordingError, counted, nearest
from deltaid.recording.address import Pick, find, listing
from deltaid.recording.columns import Channel, Columns, SensorChannels, TimeChannel
from deltaid.recording.mapped_columns import (
    DATES,
    NEEDED,
    QUANTITIES,
    SHORT_NAMES,
    TIMES,
    AllDrives,
    DriveColumn,
    Quantity,
    SensorColumns,
)
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import RENAME, LogTable
from deltaid.recording.units import SI_UNITS, si_factor
from deltaid.robot.sensors import SensorChannel

# Scale and zero of temperatures in degrees Celsius.
_CELSIUS = {"degC": (1.0, 0.0), "K": (1.0, 273.15), "degF": (5 / 9, 32.0)}
Sensors = Mapping[str, tuple[SensorChannel, ...]]


def resolve_columns(
    table: LogTable,
    linear: tuple[bool, ...],
    mapping: ColumnMapping | None = None,
    sensors: Sensors | None = None,
) -> Columns:
    """Columns of a log by quantity, from a mapping or by default names.

    Default names are t (or time), and q1…, qd1…, qdd1…, tau1… or arrays q, qd, qdd, tau, in s, rad,
    rad/s, rad/s² and N m at the joint, or in m, m/s, m/s² and N for sliding drives. A unit that the
    log states replaces the default one.

    Args:
        table: the log.
        linear: whether each drive slides.
        mapping: names and units of the columns; None for the default ones.
        sensors: channels of the robot's sensors by name.

    Raises:
        RecordingError: a column is missing, occurs twice or is declared twice; a unit does not fit;
            or a list has the wrong length.
    """
    mapping = mapping or ColumnMapping()
    time = _time(table, mapping)
    channels = {
        quantity: _declared(quantity, linear, given, mapping.source)
        if (given := getattr(mapping, quantity)) is not None
        else _under_default_names(quantity, table, linear)
        for quantity in QUANTITIES
    }
    warm = mapping.temperature
    held = (part.column for part in (*mapping.loads, warm) if part is not None)
    states = dict.fromkeys(column for column in held if column is not None)
    degrees = Channel(warm.column, *_CELSIUS[warm.unit]) if warm is not None else None
    of_sensors = sensor_columns(table, sensors or {}, mapping)
    measured = [channel.column for sensor in of_sensors for channel in sensor.channels]
    columns = Columns(
        time,
        **channels,
        extra=tuple(Channel(name, 1.0, 0.0) for name in (*measured, *states)),
        loads=mapping.loads,
        temperature=degrees,
        sensors=of_sensors,
    )
    names = [channel.column for channel in columns.recorded]
    if not columns.position:
        names += _default_names("position", len(linear))
    _require_once(names, table, mapping.source)
    _require_numbers(table.picks(names)[not time.is_absent :], columns.states, str(table.path))
    return columns


def extra_drives(table: LogTable, columns: Columns, mapping: ColumnMapping, dof: int) -> str:
    """Message about columns with default names of drives that the robot lacks; empty if there are
    none, or if a mapping names the column of each drive's position."""
    if isinstance(mapping.position, tuple):
        return ""
    used = {channel.column for channel in columns.all}
    arrays = [short for short in SHORT_NAMES.values() if f"{short}[0]" in used]

    def extra_names(drive: int) -> list[str]:
        names = [f"{SHORT_NAMES[quantity]}{drive + 1}" for quantity in QUANTITIES]
        return [name for name in names if name in table.header and name not in used] + [
            name
            for name in (f"{short}[{drive}]" for short in arrays)
            if table.can_read([columns.time.column, name])
        ]

    drives = list(takewhile(len, map(extra_names, count(dof))))
    if not drives:
        return ""
    which = "another drive" if len(drives) == 1 else f"{len(drives)} more drives"
    return f"has columns of {which} ({', '.join(chain(*drives))}), but the robot has {dof}"


def _time(table: LogTable, mapping: ColumnMapping) -> TimeChannel:
    name, unit, place = mapping.time.column, mapping.time.unit, f"{mapping.source}, time.unit"
    declared, rate = mapping.time.model_fields_set, mapping.time.rate
    if rate is not None and mapping.time.is_absent:
        return TimeChannel("time", 1 / rate, 0.0, is_absent=True)
    if "column" not in declared:
        name = next((default for default in TIMES if find(table.fields, default)), name)
    field = find(table.fields, name)
    positions = (any(find(table.fields, name) for name in names) for names in mapping.needed[1:])
    if field is None and "column" not in declared and all(positions):
        raise RecordingError(
            f"has no time: no column {' or '.join(TIMES)}; its columns are {listing(table.fields)}",
            where=table.header_place,
            cure="name its column in a mapping (--columns MAPPING.yaml) by the line "
            "`time: {column: NAME, unit: s}`, or if there is none, give the sampling rate by the "
            "line `time: {rate: 1000}`",
        )
    is_date = field is not None and field[0].is_clock
    is_span = field is not None and field[0].is_duration
    units = ("s", *DATES) if is_date else ("s",)
    if (is_date or is_span) and (rate is not None or ("unit" in declared and unit not in units)):
        kind = "dates or times of day" if is_date else "durations"
        raise RecordingError(
            f"column {name} holds {kind}, which have no unit and no rate",
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
    return [f"{SHORT_NAMES[quantity]}{i + 1}" for i in range(dof)]


def _under_default_names(
    quantity: Quantity, table: LogTable, linear: tuple[bool, ...]
) -> tuple[Channel, ...]:
    names, short = _default_names(quantity, len(linear)), SHORT_NAMES[quantity]
    if not any(name in table.header for name in names):
        array = find(table.fields, short)
        if not (find(table.fields, f"{short}[0]") and (not array or len(array[0].shape) > 1)):
            return ()
        names = [f"{short}[{i}]" for i in range(len(linear))]
    # Missing columns are kept, so that a later error names them.
    return tuple(
        _channel(
            quantity,
            DriveColumn(column=name, unit=table.units.get(name, SI_UNITS[quantity][slides])),
            slides,
            f"{table.header_place}, unit of {name}",
        )
        for name, slides in zip(names, linear, strict=True)
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
    if len(given) != dof and (given or quantity in NEEDED):
        raise RecordingError(
            f"lists {len(given)} columns, but the robot has {dof} drives",
            where=f"{source}, {quantity}",
            cure="list one column a drive, in order of q, or leave the list out",
        )
    return tuple(
        _channel(quantity, column, slides, f"{source}, {quantity}[{i}]")
        for i, (column, slides) in enumerate(zip(given, linear, strict=bool(given)))
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
    target = SI_UNITS[quantity][not motor]
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


def _require_numbers(picks: list[Pick], states: int, where: str) -> None:
    """Refuse times, and truth values except in the last columns, which are states."""
    for k, pick in enumerate(picks):
        if pick.field.is_clock or pick.field.is_duration:
            kind = "durations" if pick.field.is_duration else "dates or times of day"
            raise RecordingError(
                f"column {pick.field.name} holds {kind}, which no drive measures",
                where=where,
                cure="map another column",
            )
        if pick.field.is_truth and k < len(picks) - states:
            raise RecordingError(
                f"column {pick.field.name} holds truth values, not numbers",
                where=where,
                cure=pick.field.cure,
            )


def _require_once(names: list[str], table: LogTable, source: str) -> None:
    for name in names:
        if several := table.repeated(name):
            raise RecordingError(several, where=table.header_place, cure=RENAME)
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise RecordingError(
            f"column {name} is declared {count} times",
            where=source,
            cure="give every drive and every quantity a column of its own",
        )


def sensor_columns(
    table: LogTable, sensors: Sensors, mapping: ColumnMapping
) -> tuple[SensorChannels, ...]:
    """Channels of the sensors in a log, in the order of the description.

    By default the columns of a sensor are `plate.fx`, …, `plate.mz` (or `gauge1`), or those of an
    array `plate`; a log without them lacks the sensor.

    Raises:
        RecordingError: the robot lacks a sensor of the mapping, a list has the wrong length, a unit
            does not fit, or some columns of a sensor are missing.
    """
    for name in mapping.sensors:
        if name not in sensors:
            has = f"its sensors are {', '.join(sensors)}" if sensors else "it has none"
            raise RecordingError(
                f"the robot has no sensor {name[:40]}; {has}",
                where=f"{mapping.source}, sensors",
                cure=nearest(name, sensors).strip()
                or "describe it under `sensors:` of the robot, or leave it out here",
            )
    in_log: list[SensorChannels] = []
    for name, shown in sensors.items():
        names, where = [number.name for number in shown], f"{mapping.source}, sensors.{name}"
        is_named = name in mapping.sensors
        given = mapping.sensors[name] if is_named else _default_sensor(table, name, names)
        if given is None:
            continue
        wanted = f"the sensor shows {counted(len(shown), 'number')}: "
        entries = given.each(
            len(shown), where, wanted + ", ".join(names), "list one a number, in this order"
        )
        channels = tuple(
            Channel(
                entry["column"],
                entry["sign"] * _scale(entry["unit"], entry["column"], number, table, where),
                entry["zero"],
            )
            for entry, number in zip(entries, shown, strict=True)
        )
        in_log.append(SensorChannels(name, channels, given.delay))
    return tuple(in_log)


def _default_sensor(table: LogTable, name: str, names: list[str]) -> SensorColumns | None:
    """Columns of a sensor with default names; None if the log has none of them."""
    missing = [column for column in names if find(table.fields, column) is None]
    if len(missing) == len(names):
        names = [f"{name}[{i}]" for i in range(len(names))]
        if not find(table.fields, names[0]):
            return None
    elif missing:
        raise RecordingError(
            f"has some columns of sensor {name}, but no {', '.join(missing)}",
            where=table.header_place,
            cure="say which columns are its own by the line "
            f"`sensors: {{{name}: {{columns: [{', '.join(['…'] * len(names))}]}}}}` of a mapping, "
            f"or leave it out of this recording by `sensors: {{{name}: null}}`",
        )
    return SensorColumns(columns=tuple(names))


def _scale(
    unit: str | None, column: str, shown: SensorChannel, table: LogTable, where: str
) -> float:
    """Factor from numbers of a sensor's column to SI."""
    place = f"{table.header_place}, unit of {column}" if unit is None else f"{where}.unit"
    unit = table.units.get(column, shown.unit) if unit is None else unit
    factor = si_factor(
        unit,
        shown.unit,
        where=place,
        cure="a force is in N, kN, lbf or kgf, a moment in N*m, mN*m or lbf*in; a number may stand "
        "before it, such as 12.5 N for each volt; of a wrench list six units, forces first",
    )
    if not 0 < factor < math.inf:
        raise RecordingError(
            f"unit '{unit[:40]}' makes a factor of {factor:g}, which is no number to go on with",
            where=place,
            cure="check the number before the unit",
        )
    return factor
