"""Which columns of a table are those of a robot's sensors."""

import difflib
import math
from collections.abc import Mapping

from deltaid.errors import RecordingError
from deltaid.recording.address import find
from deltaid.recording.columns import Channel, SensorChannels
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import LogTable
from deltaid.recording.units import si_factor
from deltaid.robot.sensors import SensorChannel

Sensors = Mapping[str, tuple[SensorChannel, ...]]


def sensor_columns(
    table: LogTable, sensors: Sensors, mapping: ColumnMapping
) -> tuple[SensorChannels, ...]:
    """The channels of the sensors that a log has, in the order of the description.

    A sensor that the mapping does not name has the columns `plate.fx`, …, `plate.mz` (or `gauge1`),
    or those of an array `plate`; a log without them is one without that sensor.

    Raises:
        RecordingError: the mapping names a sensor that the robot does not have, a list has the
            wrong length, a unit does not fit, or some columns of a sensor are missing.
    """
    for name in mapping.sensors:
        if name in sensors:
            continue
        near = difflib.get_close_matches(name, sensors, n=1)
        has = f"its sensors are {', '.join(sensors)}" if sensors else "it has none"
        raise RecordingError(
            f"the robot has no sensor {name[:40]}; {has}",
            where=f"{mapping.source}, sensors",
            cure=f"did you mean {near[0]}?"
            if near
            else "describe it under `sensors:` of the robot, or leave it out here",
        )
    found: list[SensorChannels] = []
    for name, shown in sensors.items():
        given, channels = mapping.sensors.get(name), tuple[Channel, ...]()
        if name not in mapping.sensors:
            channels = _sensor_by_default(table, name, shown)
        elif given is not None:
            where, numbers = f"{mapping.source}, sensors.{name}", [number.name for number in shown]
            wanted = f"the sensor shows {len(shown)} number{'s' * (len(shown) > 1)}: "
            wanted += ", ".join(numbers)
            entries = given.each(len(shown), where, wanted, "list one a number, in this order")
            channels = tuple(
                Channel(
                    entry["column"],
                    entry["sign"]
                    * _scale(entry["unit"], entry["column"], number, table, f"{where}.unit"),
                    entry["zero"],
                )
                for entry, number in zip(entries, shown, strict=True)
            )
        if channels:
            found.append(SensorChannels(name, channels, given.delay if given else 0.0))
    return tuple(found)


def _sensor_by_default(
    table: LogTable, name: str, shown: tuple[SensorChannel, ...]
) -> tuple[Channel, ...]:
    names = [number.name for number in shown]
    there = [find(table.fields, column) is not None for column in names]
    if not any(there):
        names = [f"{name}[{i}]" for i in range(len(shown))]
        if not find(table.fields, names[0]):
            return ()
    elif not all(there):
        missing = [column for column, is_there in zip(names, there, strict=True) if not is_there]
        raise RecordingError(
            f"has some columns of sensor {name}, but no {', '.join(missing)}",
            where=table.header_place,
            cure="say which columns are its own by the line "
            f"`sensors: {{{name}: {{columns: [{', '.join(['…'] * len(shown))}]}}}}` of a mapping, "
            f"or leave it out of this recording by `sensors: {{{name}: null}}`",
        )
    return tuple(
        Channel(column, _scale(None, column, number, table, ""), 0.0)
        for column, number in zip(names, shown, strict=True)
    )


def _scale(
    unit: str | None, column: str, shown: SensorChannel, table: LogTable, where: str
) -> float:
    """What a column's numbers are to be multiplied by to become SI."""
    if unit is None:
        where = f"{table.header_place}, unit of {column}"
        unit = table.units.get(column, shown.unit)
    cure = "a force is in N, kN, lbf or kgf, a moment in N*m, mN*m or lbf*in; a number may stand "
    cure += "before it, such as 12.5 N for each volt; of a wrench list six units, forces first"
    factor = si_factor(unit, shown.unit, where=where, cure=cure)
    if not 0 < factor < math.inf:
        raise RecordingError(
            f"unit '{unit[:40]}' makes a factor of {factor:g}, which is no number to go on with",
            where=where,
            cure="check the number before the unit",
        )
    return factor
