"""The base parameters of a robot as any generic motion determines them; no recording is needed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.estimation.additions import extended
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import chunks_of_drives, collect, condense, entries_at
from deltaid.identification.measured_rows import MeasuredRows, SensorColumns
from deltaid.motion.random_motion import random_motion
from deltaid.robot.parameter import PRIOR_SPREAD
from deltaid.sensors.of_robot import all_sensor_rows
from deltaid.sensors.weighings import Weighing, weighings

_SAMPLES = 2000


def random_motion_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The base parameters that a generic motion within the robot's limits determines by torques.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    return _base(dynamics, seed)


def measured_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The same by torques together with the sensors and measured values of the description.

    Sensors' own unknowns count as unknown; their rows are of the size of torques' rows.
    """
    sensors = [SensorColumns(dynamics, rows, PRIOR_SPREAD) for rows in all_sensor_rows(dynamics)]
    return _base(dynamics, seed, sensors, weighings(dynamics.robot))


def _base(
    dynamics: Dynamics,
    seed: int,
    sensors: Sequence[SensorColumns] = (),
    known: tuple[Weighing, ...] = (),
) -> BaseParameters:
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, _SAMPLES))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    load = np.zeros_like(z)
    if dynamics.robot.load_drives:
        load = dynamics.carried(z, qd, qdd, prior_parameters(dynamics.robot))
    rows, entries = MeasuredRows(extended(dynamics, sensors), known), []
    for sensor in sensors:
        # Whatever it shows: its pose and gain are determined by something that is not constant.
        shape = len(sensor.rows.channels), _SAMPLES
        reading = np.random.default_rng(0).standard_normal(shape)
        entries.append(sensor.rows.entries(z, qd, qdd, reading))
    values = np.vstack([entries_at(dynamics, z, qd, qdd, load), *entries])
    y = np.zeros((rows.dof, _SAMPLES))
    chunks = chunks_of_drives(rows, values, y)
    condensed = condense(chunks, y, np.ones_like(y))
    information = collect(rows, [condensed], "samples", rows.dof - rows.drives)
    if known:
        facts = [np.append(fact.over(information.columns), 0.0) for fact in known]
        information = replace(information, facts=np.array(facts))
    added = (parameter for sensor in sensors for parameter in sensor.parameters)
    layout = dynamics.layout
    return base_parameters(
        information, ParameterLayout((*layout.parameters, *added), layout.bodies)
    )
