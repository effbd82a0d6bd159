"""What the sensors of a robot show: names and SI units of their channels."""

from dataclasses import dataclass

from deltaid.robot.description import RobotDescription
from deltaid.robot.sensors import BaseWrench, JointTorque

_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class SensorChannel:
    """One number that a sensor shows.

    Attributes:
        name: as a column is called by default: 'plate.fx', 'gauge1'.
        unit: N or N m.
    """

    name: str
    unit: str


def sensor_channels(robot: RobotDescription) -> dict[str, tuple[SensorChannel, ...]]:
    """The channels of each sensor, in the order of its columns."""
    found: dict[str, tuple[SensorChannel, ...]] = {}
    for name, sensor in robot.sensors.items():
        if isinstance(sensor, BaseWrench):
            units = ("N", "N", "N", "N m", "N m", "N m")
            channels = zip(_WRENCH, units, strict=True)
            found[name] = tuple(SensorChannel(f"{name}.{axis}", unit) for axis, unit in channels)
        elif isinstance(sensor, JointTorque):
            unit = "N" if robot.is_linear(sensor.drive) else "N m"
            found[name] = (SensorChannel(name, unit),)
        else:
            found[name] = (SensorChannel(name, "N"),)
    return found
