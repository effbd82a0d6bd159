"""Rows of all sensors of a robot: one class a kind."""

from functools import lru_cache

from pydantic import TypeAdapter

from deltaid.dynamics.dynamics import Dynamics
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.robot.sensors import BaseWrench, JointTorque, Sensor, StrutForce
from deltaid.sensors.base_wrench import BaseWrenchRows
from deltaid.sensors.joint_torque import JointTorqueRows
from deltaid.sensors.rows import SensorRows
from deltaid.sensors.strut_force import StrutForceRows

_SENSOR = TypeAdapter[Sensor](Sensor)


def sensor_rows(
    dynamics: Dynamics, name: str, sensor: Sensor, prior_spread: float = PRIOR_SPREAD
) -> SensorRows:
    """Rows of one sensor.

    Args:
        dynamics: of the robot.
        name: of the sensor.
        sensor: as described; the robot's own description need not have it.
        prior_spread: of the fit, which all scales of parameters are relative to.

    Raises:
        DescriptionError: the robot has nothing that such a sensor could measure.
    """
    return _made(dynamics, name, sensor.model_dump_json(), prior_spread)


@lru_cache(maxsize=64)
def _made(dynamics: Dynamics, name: str, described: str, prior_spread: float) -> SensorRows:
    """Kept with their compiled kernels for the next call; a fit is made of many."""
    sensor = _SENSOR.validate_json(described)
    match sensor:
        case BaseWrench():
            return BaseWrenchRows(dynamics, name, prior_spread, sensor)
        case StrutForce():
            return StrutForceRows(dynamics, name, prior_spread, sensor)
        case JointTorque():
            return JointTorqueRows(dynamics, name, prior_spread, sensor)


def all_sensor_rows(
    dynamics: Dynamics, prior_spread: float = PRIOR_SPREAD
) -> tuple[SensorRows, ...]:
    """Rows of all sensors of a robot's description.

    Raises:
        DescriptionError: the robot has nothing that one of them could measure.
    """
    sensors = dynamics.robot.sensors.items()
    return tuple(sensor_rows(dynamics, name, one, prior_spread) for name, one in sensors)
