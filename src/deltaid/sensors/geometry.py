"""How what a sensor shows changes with a robot's lengths, its drives' zeros and the direction of
gravity; a plate under the base leans with it.

As `dynamics.geometry` has it for torques: q is measured, so that z goes with lengths and zeros.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.geometry import (
    Error,
    GeometrySlopes,
    GrownDynamics,
    Shown,
    errors_by,
    grown_torques,
)
from deltaid.mechanism.kinematics import Samples
from deltaid.robot.description import RobotDescription
from deltaid.sensors.rows import GraphRows


def sensor_errors(
    rows: GraphRows,
    z: Samples,
    qd: Samples,
    qdd: Samples,
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
    rows: GraphRows
    values: Float[np.ndarray, " columns"]

    def shown(
        self,
        z: Samples,
        rates: Float[np.ndarray, "samples rates"],
        growth: Float[np.ndarray, " growth"],
        gravity: Float[np.ndarray, " 3"],
    ) -> Shown:
        robot = self.rows.dynamics.robot.changed(gravity=tuple(gravity.tolist()))
        graph = _graph(robot.model_dump_json(), self.rows)
        return np.array(graph(z.T, rates.T, self.values, growth))


@lru_cache(maxsize=32)
def _graph(description: str, rows: GraphRows) -> ca.Function:
    """What a sensor of a robot shows, of z, [q̇, q̈], columns' values and growth."""
    dynamics = GrownDynamics(RobotDescription.model_validate_json(description))
    graph, mechanism = replace(rows, dynamics=dynamics).graph, dynamics.kinematics.mechanism
    values, rates = ca.SX.sym("values", graph.shape[1]), mechanism.speeds.q
    inputs = [mechanism.z, ca.vertcat(rates.u, rates.ud), values, dynamics.growth]
    return ca.Function("shown", inputs, [graph @ values])
