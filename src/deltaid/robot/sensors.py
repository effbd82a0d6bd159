"""Additional sensors of a description, and their channels.

Noise, biases and tolerances are one standard deviation each. A recording's mapping names the
columns of a sensor.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from deltaid.robot.part import Coordinate, NotNegative, Part, Point, Positive, Vector
from deltaid.robot.tolerances import AngleTolerance, LengthTolerance

if TYPE_CHECKING:
    from deltaid.robot.description import RobotDescription

Share = Annotated[float, Field(ge=0, lt=1)]
Bias = Annotated[
    NotNegative | None,
    Field(description="standard deviation of its offset; 0 if tared; unknown by default"),
]


class BaseWrench(Part):
    """A six-axis sensor under the base: force and moment that it exerts on the robot.

    Moments are about its origin, and all six are along its axes, so at rest it shows the robot's
    weight as a force upwards.
    """

    kind: Literal["base-wrench"] = Field(description="six axes under the base")
    position: Point = Field(default=(0.0, 0.0, 0.0), description="its origin in the world, m")
    rotation_deg: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="roll, pitch, yaw of its axes in the world, degrees: Rz(yaw) Ry(pitch) "
        "Rx(roll)",
    )
    force_noise: Positive = Field(default=1.0, description="N")
    moment_noise: Positive = Field(default=0.1, description="N m")
    force_bias: Bias = None
    moment_bias: Bias = None
    position_tolerance: LengthTolerance = Field(default=0.0, description="m, along each axis")
    rotation_tolerance: AngleTolerance = Field(default=0.0, description="rad, about each axis")
    gain_tolerance: Share = Field(default=0.0, description="common to all channels, as a share")
    motor_turns: Coordinate | dict[str, Coordinate] | None = Field(
        default=None,
        description="turns of a motor for one of its drive (per m of a rail), negative where it "
        "turns the other way; by drive if they differ; what rotors do to the base is identified "
        "where this is not given",
    )


class StrutForce(Part):
    """A gauge along a strut, or along both of a limb, whose sum it shows; a pull is positive."""

    kind: Literal["strut-force"] = Field(description="a gauge along a strut")
    strut: str = Field(description="strut1a, strut1b, …; strut1 for the sum of a limb's")
    at: Literal["platform", "elbow", "middle"] = Field(
        default="middle", description="at a joint, or somewhere between both"
    )
    noise: Positive = Field(default=1.0, description="N")
    bias: Bias = None
    gain_tolerance: Share = Field(default=0.0, description="as a share")


class JointTorque(Part):
    """A torque sensor between gear and arm (a force sensor, for a rail)."""

    kind: Literal["joint-torque"] = Field(description="torque between gear and arm")
    drive: str = Field(description="drive1, drive2, …")
    noise: Positive = Field(default=0.1, description="N m, or N for a rail")
    bias: Bias = None
    gain_tolerance: Share = Field(default=0.0, description="as a share")


Sensor = Annotated[BaseWrench | StrutForce | JointTorque, Field(discriminator="kind")]


@dataclass(frozen=True)
class SensorChannel:
    """One channel of a sensor.

    Attributes:
        name: default name of its column, such as 'plate.fx' or 'gauge1'.
        unit: N or N m.
        noise: standard deviation of its noise, in this unit.
    """

    name: str
    unit: str
    noise: float


def channels_of(robot: "RobotDescription", name: str, sensor: Sensor) -> tuple[SensorChannel, ...]:
    """Channels of a sensor in column order; the robot's description need not have the sensor."""
    if isinstance(sensor, BaseWrench):
        kinds = ("f", "N", sensor.force_noise), ("m", "N m", sensor.moment_noise)
        return tuple(
            SensorChannel(f"{name}.{letter}{axis}", unit, noise)
            for letter, unit, noise in kinds
            for axis in "xyz"
        )
    turns = isinstance(sensor, JointTorque) and not robot.is_linear(sensor.drive)
    return (SensorChannel(name, "N m" if turns else "N", sensor.noise),)
