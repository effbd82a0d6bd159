"""The base parameters of a robot as any generic motion determines them; no recording is needed."""

from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import Information, gather_samples, triangle
from deltaid.motion.random_motion import random_motion
from deltaid.sensors.of_robot import all_sensor_rows
from deltaid.sensors.weighings import weighings

_SAMPLES = 2000

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def random_motion_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The base parameters that a generic motion within the robot's limits determines by torques.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    return base_parameters(_by_torques(dynamics, _motion(dynamics, seed)), dynamics.layout)


def measured_base(dynamics: Dynamics, seed: int = 0) -> BaseParameters:
    """The same by torques together with the sensors and measured values of the description.

    Sensors' own unknowns count as unknown; their rows are of the size of torques' rows.
    """
    motion, layout = _motion(dynamics, seed), dynamics.layout
    torques, facts, channels = _by_torques(dynamics, motion), weighings(dynamics.robot), []
    used = [torques.columns, *(np.flatnonzero(fact.coefficients) for fact in facts)]
    parameters, count = list(layout.parameters), len(layout.names)
    for sensor in all_sensor_rows(dynamics):
        rows, columns = sensor.pattern
        places = np.where(columns < count, columns, columns - count + len(parameters))
        parameters += sensor.parameters
        used.append(places)
        # Whatever it shows: its pose and gain are determined by something that is not constant.
        reading = np.random.default_rng(0).standard_normal((len(sensor.channels), _SAMPLES))
        entries = sensor.entries(*motion, reading)
        numbers = range(len(sensor.channels))
        channels += [(places[rows == k], entries[rows == k].T) for k in numbers]
    columns = np.unique(np.concatenate(used))
    n, last = len(columns) + 1, len(columns)
    factors = [
        _widened(factor, np.append(np.searchsorted(columns, torques.columns), last), n)
        for factor in torques.factors
    ]
    for places, entries in channels:
        wide = _widened(entries, np.searchsorted(columns, places), n)
        factors.append(triangle(np.vstack([wide, np.zeros((n, n))])))
    samples = np.full(len(factors), float(_SAMPLES))
    information = Information(columns, np.stack(factors), samples, np.ones(len(factors)))
    if facts:
        known = np.array([np.append(fact.over(columns), 0.0) for fact in facts])
        information = replace(information, facts=known)
    return base_parameters(information, ParameterLayout(tuple(parameters), layout.bodies))


def _motion(dynamics: Dynamics, seed: int) -> Motion:
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, _SAMPLES))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    return z, qd, qdd


def _by_torques(dynamics: Dynamics, motion: Motion) -> Information:
    load = None
    if dynamics.robot.load_drives:
        load = dynamics.carried(*motion, prior_parameters(dynamics.robot))
    return gather_samples(dynamics, *motion, np.zeros_like(motion[0]), load)


def _widened(rows: np.ndarray, places: np.ndarray, columns: int) -> np.ndarray:
    wide = np.zeros((len(rows), columns))
    wide[:, places] = rows
    return wide
