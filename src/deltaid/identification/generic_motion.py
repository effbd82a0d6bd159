"""The base parameters of a robot as any generic motion determines them; no recording is needed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import (
    ExplainingColumns,
    chunks_of_drives,
    collect,
    condense,
    entries_at,
)
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import RobotLike, load_robot
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.robot_sensors import all_sensor_rows
from deltaid.sensors.rows import SensorRows
from deltaid.sensors.weighings import Weighing, weighings

# Number of samples: many more than base parameters, so that they determine all that a motion can.
SAMPLES = 2000


def random_motion_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The base parameters that a generic motion within the robot's limits determines by torques.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    return _base(dynamics, seed, dynamics)


def base(robot: RobotLike, *, seed: int = 0) -> BaseParameters:
    """Base parameters of a robot: the combinations that torques determine, with all its sensors.

    Args:
        seed: of the random motion that determines them.

    Raises:
        DescriptionError: there is no such robot.
        KinematicsError: the description's limits leave no room for a motion.
    """
    return measured_base(compiled(load_robot(robot)), seed)


def measured_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The same by torques together with the sensors and measured values of the description.

    Sensors' own unknowns count as unknown; their rows are of the size of torques' rows.
    """
    known, sensor_rows = weighings(dynamics.robot), all_sensor_rows(dynamics)
    if not known and not sensor_rows:
        return random_motion_base(dynamics, seed)
    # Slow to load, and seldom needed.
    from deltaid.estimation.additions import extended
    from deltaid.identification.measured_rows import MeasuredRows, SensorAddition

    sensors = [SensorAddition(dynamics, rows, PRIOR_SPREAD) for rows in sensor_rows]
    rows = MeasuredRows(extended(dynamics, sensors), known)
    return _base(dynamics, seed, rows, sensor_rows, known)


def _base(
    dynamics: Dynamics,
    seed: int,
    rows: ExplainingColumns,
    sensors: Sequence[SensorRows] = (),
    known: Sequence[Weighing] = (),
) -> BaseParameters:
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, SAMPLES))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    load = np.zeros_like(z)
    if dynamics.robot.load_drives:
        load = dynamics.carried(z, qd, qdd, prior_parameters(dynamics.robot))
    entries = [entries_at(dynamics, z, qd, qdd, load)]
    for sensor in sensors:
        # Any reading that is not constant determines pose and gain.
        reading = np.random.default_rng(0).standard_normal((len(sensor.channels), SAMPLES))
        entries.append(sensor.entries(z, qd, qdd, reading))
    y = np.zeros((rows.dof, SAMPLES))
    condensed = condense(chunks_of_drives(rows, np.vstack(entries), y), y, np.ones_like(y))
    information = collect(rows, [condensed], "samples", rows.dof - dynamics.dof)
    if known:
        facts = [np.append(fact.over(information.columns), 0.0) for fact in known]
        information = replace(information, facts=np.array(facts))
    added = (parameter for sensor in sensors for parameter in sensor.parameters)
    layout = ParameterLayout((*dynamics.layout.parameters, *added), dynamics.layout.bodies)
    try:
        return base_parameters(information, layout)
    except IdentificationError as error:
        raise IdentificationError(
            f"{error.what}, although it uses the description's limits",
            where=dynamics.robot.name,
            cure="raise the limits of drives or platform, or widen the workspace: likeliest one is "
            "in another unit",
        ) from None
