"""All sensors of a robot: their rows, one class a kind, what they would show along a motion, and
how that changes with the robot's lengths, its drives' zeros and the direction of gravity.

As `dynamics.geometry` has it for torques: q is measured, so that z goes with lengths and zeros. A
plate under the base leans with it.
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
        sensor: as described; the robot's own description need not have it.
        prior_spread: of the fit, which all scales of parameters are relative to.

    Raises:
        DescriptionError: the robot has nothing that such a sensor could measure.
    """
    return _made(dynamics, name, type(sensor), sensor.model_dump_json(), prior_spread)


@lru_cache(maxsize=64)
def _made(
    dynamics: Dynamics, name: str, kind: type[Sensor], described: str, prior_spread: float
) -> SensorRows:
    """Kept with their compiled kernels for the next call; a fit is made of many."""
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


# What a sensor shows stands in its own columns where gain or pose is off: put in so often.
_ROUNDS = 30
# A part of a robot is so far from its prior, as a share of what its prior allows.
_AWAY = 0.3

Unknowns = Float[np.ndarray, " unknowns"]


def drawn_unknowns(rows: SensorRows) -> Unknowns:
    """Unknowns of one sensor, the same for one name, so in all recordings of a robot.

    Biases, gains and poses are drawn as the description says; what belongs to the robot's parts,
    such as a rotor's spin, is as near to its prior as its bodies are to theirs.
    """
    rng = np.random.default_rng([0, zlib.crc32(rows.name.encode())])

    def drawn(parameter: PriorParameter) -> float:
        own = parameter.symbol.startswith(("spin", "outer"))
        return _AWAY * rng.uniform(-1, 1) if own else rng.standard_normal()

    return np.array([entry.prior + entry.std * drawn(entry) for entry in rows.parameters])


def shown_by(
    rows: SensorRows, p: Parameters, u: Unknowns, z: Motion, qd: Motion, qdd: Motion
) -> Shown:
    """y = C p + D(y) u, what one sensor shows without noise, in the order of its channels."""
    channels, columns = rows.pattern
    shown = np.zeros((len(rows.channels), len(z)))
    values = np.append(p, u)[columns][:, None]
    for _ in range(_ROUNDS):
        before, shown = shown, np.zeros_like(shown)
        np.add.at(shown, channels, values * rows.entries(z, qd, qdd, before))
        if np.allclose(shown, before, rtol=1e-14, atol=0.0):
            break
    return shown


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
        rng: of the sensors' noise; without one there is none, and nothing else that is unknown.
    """
    columns: dict[str, np.ndarray] = {}
    for rows in all_sensor_rows(dynamics):
        u = drawn_unknowns(rows)
        if rng is None:
            u = np.array([parameter.prior for parameter in rows.parameters])
        for channel, values in zip(rows.channels, shown_by(rows, p, u, z, qd, qdd), strict=True):
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
    """What each tolerance of the robot's description does to what one of its sensors shows.

    Args:
        z, qd, qdd: samples of a motion, as described.
        values: p, and the sensor's unknowns behind it; of these only those count whose columns
            follow from the motion.
    """
    robot, own = rows.dynamics.robot, len(rows.dynamics.layout.names) + len(rows.moving)
    rates, gravity = np.hstack([qd, qdd]), np.array(robot.gravity)
    return errors_by(
        robot, _SensorSlopes(grown_torques(robot), z, rates, gravity, rows, values[:own])
    )


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
    """What a sensor of a robot shows, of z, [q̇, q̈], columns' values and growth."""
    dynamics = GrownDynamics(RobotDescription.model_validate_json(description))
    graph, mechanism = replace(rows, dynamics=dynamics).graph, dynamics.kinematics.mechanism
    values, rates = ca.SX.sym("values", graph.shape[1]), mechanism.speeds.q
    inputs = [mechanism.z, ca.vertcat(rates.u, rates.ud), values, dynamics.growth]
    return ca.Function("shown", inputs, [graph @ values])
