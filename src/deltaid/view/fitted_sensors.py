"""Tables of the sensors beside the drives, for the terminal and for pages alike."""

from collections.abc import Sequence

from deltaid.model.sensor_record import FittedSensor
from deltaid.view.model_tables import MEASURED, origin, value_and_width
from deltaid.view.numbers import number
from deltaid.view.table import Table


def sensor_tables(sensors: Sequence[FittedSensor]) -> tuple[Table, ...]:
    """What the fit leaves of each channel, and what it found of the sensors; none without any."""
    if not sensors:
        return ()
    channels = Table(
        ("channel", "largest", "left by the fit", "noise stated", "unit"),
        tuple(
            (one.name, number(one.largest, 3), number(one.left, 2), number(one.stated, 2), one.unit)
            for sensor in sensors
            for one in sensor.channels
        ),
        "Root mean square of what the fit leaves, after the low-pass, which lets only a part of "
        "the stated noise through. Each channel counts by what is left of it.",
        title="sensors",
    )
    found = [one for sensor in sensors for one in sensor.parameters]
    unknown = Table(
        ("of the sensor", "value", "± (95 %)", "unit", "from"),
        tuple((one.name, *value_and_width(one), one.unit, origin(one)) for one in found),
        "What was unknown of sensors, fitted with the robot.",
        frozenset(i for i, one in enumerate(found) if one.determined_by not in MEASURED),
        "unknowns of sensors",
    )
    return (channels, unknown) if found else (channels,)
