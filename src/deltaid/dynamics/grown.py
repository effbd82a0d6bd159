"""Robots whose lengths exceed those described by symbols: torques, drive coordinates, and where
such a robot is that has measured some q."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.joint_columns import joint_columns
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.mechanism.composition import build_mechanism
from deltaid.mechanism.growth import LengthGrowth, grown_by
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.rotation import fixed
from deltaid.robot.description import RobotDescription

# Step of lengths [m] and zeros [rad or m], and the share of gravity that it turns by: large against
# rounding, and so small that no other joint turns round within it.
STEP = 1e-6


@dataclass(frozen=True, eq=False)
class GrownPoses:
    """Where a robot is that has measured some q, if lengths or zeros are `STEP` more.

    Attributes:
        position: q and J as functions of z and growth.
        z: where it would be as described.
        symbols: how many lengths may grow.
    """

    position: ca.Function
    z: Samples
    symbols: int

    def with_growth(
        self, direction: Float[np.ndarray, " growth"]
    ) -> tuple[Samples, Float[np.ndarray, " growth"]]:
        """z and the growth, `STEP` times a direction of its symbols."""
        grown, (q, J) = STEP * direction, self._described
        later = np.array(self.position(self.z.T, grown)[0]).T
        return self.z - np.linalg.solve(J, (later - q)[:, :, None])[:, :, 0], grown

    def with_drives(self, q: Samples) -> Samples:
        """z where drives are `STEP` times q further."""
        _, J = self._described
        return self.z + STEP * np.linalg.solve(J, q[:, :, None])[:, :, 0]

    @cached_property
    def _described(self) -> tuple[Samples, Float[np.ndarray, "samples dof dof"]]:
        """Drive coordinates q and J = ∂q/∂z as described."""
        (q, J), dof = self.position(self.z.T, np.zeros(self.symbols)), self.z.shape[1]
        return np.array(q).T, np.array(J).reshape(dof, -1, dof).swapaxes(0, 1)


@dataclass(frozen=True, eq=False)
class GrownTorques:
    """A robot's torques and drive coordinates as functions of its lengths and of gravity.

    Attributes:
        numbers: of the symbols of each kind of length.
        symbols: how many there are.
        torque: of (z, [q̇, q̈], p, growth, gravity).
        position: q and J of (z, growth).
    """

    numbers: dict[str, tuple[int, ...]]
    symbols: int
    torque: ca.Function
    position: ca.Function


class _Turned(SpeedForces):
    """Forces under any gravity."""

    def __init__(self, robot: RobotDescription, mechanism: Mechanism, gravity: ca.SX) -> None:
        super().__init__(robot, mechanism)
        self._gravity = gravity

    def gravity(self, body: MovingBody) -> ca.SX:
        """In the inertial frame of a body."""
        return fixed(body.R_WL.T) @ self._gravity


def grown_torques(robot: RobotDescription, mounted: bool = False) -> "GrownTorques":
    """Torques and drive coordinates of a robot that may grow, kept for the next call; with symbols
    of how limbs are mounted, or without."""
    return _grown(robot.model_dump_json(), mounted)


class GrownDynamics(Dynamics):
    """A robot whose lengths exceed those described by symbols."""

    def __init__(self, robot: RobotDescription) -> None:
        super().__init__(robot)
        growth = LengthGrowth.named(len(robot.limb_geometry))
        self.growth: ca.SX = growth.symbols
        self.kinematics.mechanism = build_mechanism(robot, growth)


@lru_cache(maxsize=4)
def _grown(description: str, mounted: bool) -> GrownTorques:
    robot, gravity = RobotDescription.model_validate_json(description), ca.SX.sym("g", 3)
    growth = LengthGrowth.named(len(robot.limb_geometry), mounted)
    mechanism, symbols = build_mechanism(robot, growth), growth.symbols
    forces, speeds = _Turned(robot, mechanism, gravity), mechanism.speeds
    motion, still = speeds.by_drives(), ca.SX.zeros(mechanism.dof)
    joints = (
        forces.joint_columns(joint_columns(robot), still) @ forces.p[forces.layout.coefficients]
    )
    torque = speeds.drives_to_all.T @ motion(forces.of_bodies() + joints)
    rates = ca.vertcat(speeds.q.u, speeds.q.ud)
    return GrownTorques(
        grown_by(robot),
        symbols.numel(),
        ca.Function("torque", [mechanism.z, rates, forces.p, symbols, gravity], [torque]),
        ca.Function("position", [mechanism.z, symbols], [mechanism.q, ca.densify(speeds.jacobian)]),
    )
