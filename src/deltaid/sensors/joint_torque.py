"""A torque sensor between gear and arm: the drive's row of Y without its motor.

Friction and rotor of the drive stand on the motor's side, friction that depends on load as well.
Springs across the joint and all that other joints take stay on the link's side. For a rail it is a
force sensor between spindle and carriage.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import joint_columns
from deltaid.errors import DescriptionError
from deltaid.robot.sensors import JointTorque
from deltaid.sensors.rows import GraphRows, Unknown, wide_force, wide_moment


@dataclass(frozen=True, eq=False)
class JointTorqueRows(GraphRows):
    """One torque sensor.

    Raises:
        DescriptionError: there is no such drive.
    """

    sensor: JointTorque

    def __post_init__(self) -> None:
        drives = self.dynamics.robot.drives
        if self.sensor.drive not in drives:
            raise DescriptionError(
                f"there is no drive '{self.sensor.drive}'; there are {', '.join(drives)}",
                where=f"sensors.{self.name}.drive",
                cure="name one of these",
            )

    @property
    def still(self) -> tuple[Unknown, ...]:
        bias = self.sensor.bias
        if bias is None and self.dynamics.robot.is_linear(self.sensor.drive):
            bias = wide_force(self.dynamics)
        elif bias is None:
            bias = wide_moment(self.dynamics, np.zeros(3))
        return (*self.bias(0, "bias", bias), *self.gain(self.sensor.gain_tolerance))

    @property
    def graph(self) -> ca.SX:
        robot, layout = self.dynamics.robot, self.dynamics.layout
        row = self.dynamics.equations.Y[robot.drives.index(self.sensor.drive), :]
        motor = {
            k
            for k, column in enumerate(joint_columns(robot), start=layout.coefficients.start)
            if column.joint == self.sensor.drive and column.parameter.kind != "spring"
        }
        return ca.horzcat(*(ca.SX(1, 1) if k in motor else row[k] for k in range(row.numel())))
