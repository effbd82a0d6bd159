"""The base parameters of a robot as any generic motion determines them; no recording is needed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.information import Information, gather_samples, triangle
from deltaid.motion.random_motion import random_motion
from deltaid.sensors.of_robot import all_sensor_rows
from deltaid.sensors.rows import SensorRows
from deltaid.sensors.weighings import Weighing, weighings

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

    Sensors' own unknowns count as unknown.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motion = _motion(dynamics, seed)
    sensors, facts = all_sensor_rows(dynamics), weighings(dynamics.robot)
    torques = _by_torques(dynamics, motion)
    more = tuple(parameter for one in sensors for parameter in one.parameters)
    layout = ParameterLayout((*dynamics.layout.parameters, *more), dynamics.layout.bodies)
    return base_parameters(_with_more(torques, dynamics, sensors, facts, motion), layout)


def _motion(dynamics: Dynamics, seed: int) -> Motion:
    motion = random_motion(dynamics.kinematics, np.random.default_rng(seed))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, _SAMPLES))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    return z, qd, qdd


def _by_torques(dynamics: Dynamics, motion: Motion) -> Information:
    z, qd, qdd = motion
    tau, load = np.zeros_like(z), None
    if dynamics.robot.load_drives:
        load = dynamics.carried(z, qd, qdd, prior_parameters(dynamics.robot))
    return gather_samples(dynamics, z, qd, qdd, tau, load)


def _with_more(
    torques: Information,
    dynamics: Dynamics,
    sensors: Sequence[SensorRows],
    facts: Sequence[Weighing],
    motion: Motion,
) -> Information:
    """With rows of sensors, each of the size of torques' rows, and of measured values."""
    first, own = len(dynamics.layout.names), len(dynamics.layout.names)
    parts, used = [], [torques.columns, *(np.flatnonzero(one.coefficients) for one in facts)]
    for one in sensors:
        channels, columns = one.pattern
        at = np.where(columns < own, columns, columns - own + first)
        first += len(one.parameters)
        used.append(at)
        parts.append((one, at, channels))
    columns = np.unique(np.concatenate(used))
    factors = [_widened(factor, torques.columns, columns) for factor in torques.factors]
    for one, at, channels in parts:
        # Whatever it shows: its pose and gain are told by something that is not constant.
        shown = np.random.default_rng(0).standard_normal((len(one.channels), _SAMPLES))
        entries = one.entries(*motion, shown)
        for k in range(len(one.channels)):
            rows = np.zeros((_SAMPLES, len(columns) + 1))
            rows[:, np.searchsorted(columns, at[channels == k])] = entries[channels == k].T
            padded = np.vstack([rows, np.zeros((len(columns) + 1, len(columns) + 1))])
            factors.append(triangle(padded))
    samples = np.full(len(factors), float(_SAMPLES))
    information = Information(columns, np.stack(factors), samples, np.ones(len(factors)))
    if not facts:
        return information
    known = np.array([np.append(one.over(columns), 0.0) for one in facts])
    return replace(information, facts=known)


def _widened(
    factor: Float[np.ndarray, "n n"], before: np.ndarray, columns: np.ndarray
) -> Float[np.ndarray, "wide wide"]:
    """A factor over more columns."""
    wide = np.zeros((len(columns) + 1, len(columns) + 1))
    at = np.append(np.searchsorted(columns, before), len(columns))
    wide[: len(at), at] = factor
    return wide
