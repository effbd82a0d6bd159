"""Rows of all sensors of a robot, their values along a motion, and the derivatives of these with
respect to lengths, drives' zeros and the direction of gravity.

As for torques in `dynamics.geometry`, q is measured, so z depends on lengths and zeros. A sensor
under the base tilts with it.
"""

import zlib
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.geometry import Error, GeometrySlopes, GrownDynamics, errors_by, grown_torques
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter
from deltaid.robot.sensors import BaseWrench, JointTorque, Sensor, StrutForce
from deltaid.sensors.base_wrench import BaseWrenchRows
from deltaid.sensors.inner_forces import JointTorqueRows, StrutForceRows
from deltaid.sensors.rows import Motion, SensorRows, Shown

_KINDS: dict[type[Sensor], type[SensorRows]] = {
    BaseWrench: BaseWrenchRows, StrutForce: StrutForceRows, JointTorque: JointTorqueRows,
}  # fmt: skip


def sensor_rows(
    dynamics: Dynamics, name: str, sensor: Sensor, prior_spread: float = PRIOR_SPREAD
) -> SensorRows:
    """Rows of one sensor.

    Args:
        dynamics: of the robot.
        name: of the sensor.
        sensor: its description, which the robot's need not contain.
        prior_spread: of the fit; all scales of parameters are relative to it.

    Raises:
        DescriptionError: the robot has nothing that such a sensor could measure.
    """
    return _cached_rows(dynamics, name, type(sensor), sensor.model_dump_json(), prior_spread)


@lru_cache(maxsize=64)
def _cached_rows(
    dynamics: Dynamics, name: str, kind: type[Sensor], described: str, prior_spread: float
) -> SensorRows:
    """Rows with their compiled kernels, cached because a fit requests them many times."""
    return _KINDS[kind](dynamics, name, prior_spread, kind.model_validate_json(described))


def all_sensor_rows(
    dynamics: Dynamics, prior_spread: float = PRIOR_SPREAD
) -> tuple[SensorRows, ...]:
    """Rows of all sensors of a robot's description.

    Raises:
        DescriptionError: the robot has nothing that one of them could measure.
    """
    sensors = dynamics.robot.sensors.items()
    return tuple(sensor_rows(dynamics, name, sensor, prior_spread) for name, sensor in sensors)


# Largest deviation of drawn unknowns of the robot's parts, as a share of their prior deviation.
_AWAY = 0.3

Unknowns = Float[np.ndarray, " unknowns"]


def drawn_unknowns(rows: SensorRows) -> Unknowns:
    """Random unknowns of one sensor, seeded by its name, so equal in all recordings of a robot.

    Biases, gains and poses are drawn from the described distributions. Properties of the robot's
    parts, such as a rotor's spin, deviate from their priors as little as its bodies do.
    """
    rng = np.random.default_rng([0, zlib.crc32(rows.name.encode())])

    def drawn(parameter: PriorParameter) -> float:
        of_robot = parameter.symbol.startswith(("spin", "outer"))
        return _AWAY * rng.uniform(-1, 1) if of_robot else rng.standard_normal()

    return np.array([entry.prior + entry.std * drawn(entry) for entry in rows.parameters])


def simulated_sensors(
    dynamics: Dynamics,
    p: Parameters,
    z: Motion,
    qd: Motion,
    qdd: Motion,
    rng: np.random.Generator | None = None,
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Columns of all sensors of a robot by their default names.

    Args:
        dynamics: of the robot.
        p: its true parameters.
        z, qd, qdd: the motion.
        rng: of the sensors' noise; without one, noise is zero and unknowns are at their priors.
    """
    columns: dict[str, np.ndarray] = {}
    for rows in all_sensor_rows(dynamics):
        prior = np.array([parameter.prior for parameter in rows.parameters])
        u = prior if rng is None else drawn_unknowns(rows)
        shown = rows.shown(np.append(p, u), z, qd, qdd)
        for channel, values in zip(rows.channels, shown, strict=True):
            noise = 0.0 if rng is None else channel.noise * rng.standard_normal(len(values))
            columns[channel.name] = values + noise
    return columns


def sensor_errors(
    rows: SensorRows,
    z: Motion,
    qd: Motion,
    qdd: Motion,
    values: Float[np.ndarray, " columns"],
) -> tuple[Error, ...]:
    """Change of one sensor's values by each tolerance of the robot's description.

    Args:
        z, qd, qdd: samples of a motion, as described.
        values: p, then the sensor's unknowns; only those whose columns follow from the motion are
            used.
    """
    robot, width = rows.dynamics.robot, len(rows.dynamics.layout.names) + len(rows.moving)
    slopes = _SensorSlopes(
        grown_torques(robot),
        z,
        np.hstack([qd, qdd]),
        np.array(robot.gravity),
        rows,
        values[:width],
    )
    return errors_by(robot, slopes)


@dataclass(frozen=True, eq=False)
class _SensorSlopes(GeometrySlopes):
    rows: SensorRows
    values: Float[np.ndarray, " columns"]

    def shown(
        self,
        z: Motion,
        rates: Float[np.ndarray, "samples rates"],
        growth: Float[np.ndarray, " growth"],
        gravity: Float[np.ndarray, " 3"],
    ) -> Shown:
        robot = self.rows.dynamics.robot.changed(gravity=tuple(gravity.tolist()))
        graph = _graph(robot.model_dump_json(), self.rows)
        return np.array(graph(z.T, rates.T, self.values, growth))


@lru_cache(maxsize=32)
def _graph(description: str, rows: SensorRows) -> ca.Function:
    """A sensor's values as a function of z, [q̇, q̈], columns' values and growth."""
    dynamics = GrownDynamics(RobotDescription.model_validate_json(description))
    graph, mechanism = replace(rows, dynamics=dynamics).graph, dynamics.kinematics.mechanism
    values, rates = ca.SX.sym("values", graph.shape[1]), mechanism.speeds.q
    inputs = [mechanism.z, ca.vertcat(rates.u, rates.ud), values, dynamics.growth]
    return ca.Function("shown", inputs, [graph @ values])
