"""How what a sensor shows changes with a robot's lengths, its drives' zeros and the direction of
gravity; a plate under the base leans with it.

As `dynamics.geometry` has it for torques: q is measured, so that z goes with lengths and zeros.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.geometry import Error, Shown, errors_by
from deltaid.dynamics.grown import STEP, GrownDynamics, GrownPoses, grown_torques
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
    position, symbols = grown_torques(robot).position, grown_torques(robot).symbols
    rates = np.hstack([qd, qdd])
    slopes = _SensorSlopes(rows, z, rates, values[:own], GrownPoses(position, z, symbols))
    return errors_by(robot, slopes)


@dataclass(frozen=True, eq=False)
class _SensorSlopes:
    """Of what a sensor shows, by differences."""

    rows: GraphRows
    z: Samples
    rates: Float[np.ndarray, "samples rates"]
    values: Float[np.ndarray, " columns"]
    places: GrownPoses

    @property
    def numbers(self) -> dict[str, tuple[int, ...]]:
        return grown_torques(self.rows.dynamics.robot).numbers

    def of_length(self, number: int) -> Shown:
        z, growth = self.places.with_length(number)
        return (self._shown(z, growth) - self._described) / STEP

    def of_zero(self, drive: int) -> Shown:
        return (self._shown(self.places.with_zero(drive)) - self._described) / STEP

    def of_gravity(self, axis: Float[np.ndarray, " 3"]) -> Shown:
        robot = self.rows.dynamics.robot
        g = np.array(robot.gravity) + np.cross(axis, robot.gravity)
        return self._shown(self.z, gravity=tuple(g.tolist())) - self._described

    @cached_property
    def _described(self) -> Shown:
        return self._shown(self.z)

    def _shown(
        self,
        z: Samples,
        growth: Float[np.ndarray, " growth"] | None = None,
        gravity: tuple[float, ...] | None = None,
    ) -> Shown:
        robot = self.rows.dynamics.robot
        robot = robot if gravity is None else robot.changed(gravity=gravity)
        graph = _graph(robot.model_dump_json(), self.rows)
        grown = np.zeros(self.places.symbols) if growth is None else growth
        return np.array(graph(z.T, self.rates.T, self.values, grown))


@lru_cache(maxsize=32)
def _graph(description: str, rows: GraphRows) -> ca.Function:
    """What a sensor of a robot shows, of z, [q̇, q̈], columns' values and growth."""
    dynamics = GrownDynamics(RobotDescription.model_validate_json(description))
    graph, mechanism = replace(rows, dynamics=dynamics).graph, dynamics.kinematics.mechanism
    values, rates = ca.SX.sym("values", graph.shape[1]), mechanism.speeds.q
    inputs = [mechanism.z, ca.vertcat(rates.u, rates.ud), values, dynamics.growth]
    return ca.Function("shown", inputs, [graph @ values])
