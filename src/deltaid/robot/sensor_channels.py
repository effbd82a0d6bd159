"""What the sensors of a robot show: names and SI units of their channels, and their noise."""

from dataclasses import dataclass

from deltaid.robot.description import RobotDescription
from deltaid.robot.sensors import BaseWrench, JointTorque, Sensor


@dataclass(frozen=True)
class SensorChannel:
    """One number that a sensor shows.

    Attributes:
        name: as a column is called by default: 'plate.fx', 'gauge1'.
        unit: N or N m.
        noise: its standard deviation.
    """

    name: str
    unit: str
    noise: float


def sensor_channels(robot: RobotDescription) -> dict[str, tuple[SensorChannel, ...]]:
    """The channels of each sensor, in the order of its columns."""
    return {name: channels_of(robot, name, sensor) for name, sensor in robot.sensors.items()}


def channels_of(robot: RobotDescription, name: str, sensor: Sensor) -> tuple[SensorChannel, ...]:
    """The channels of one sensor, which the robot's own description need not have."""
    if isinstance(sensor, BaseWrench):
        kinds = ("f", "N", sensor.force_noise), ("m", "N m", sensor.moment_noise)
        return tuple(
            SensorChannel(f"{name}.{letter}{axis}", unit, noise)
            for letter, unit, noise in kinds
            for axis in "xyz"
        )
    turns = isinstance(sensor, JointTorque) and not robot.is_linear(sensor.drive)
    return (SensorChannel(name, "N m" if turns else "N", sensor.noise),)
