"""How torques change with a robot's lengths, its drives' zeros and the direction of gravity.

A recording has drive coordinates q, whatever the geometry is. With torques τ(z, q̇, q̈; g) and
coordinates q(z; g) of lengths g, and J = ∂q/∂z,

    dτ/dg = ∂τ/∂g − ∂τ/∂z J⁻¹ ∂q/∂g,    dτ/dq_0 = ∂τ/∂z J⁻¹.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol, runtime_checkable

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.joint_columns import joint_columns
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.mechanism.composition import build_mechanism
from deltaid.mechanism.growth import Growth, grown_by
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.vectors import fixed
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

# Step of lengths [m] and zeros [rad or m], and the share of gravity that it turns by: large against
# rounding, and so small that no other joint turns round within it.
STEP = 1e-6

# Torques of all drives, or channels of a sensor, at some samples.
Shown = Float[np.ndarray, "channels samples"]


@dataclass(frozen=True, eq=False)
class Error:
    """What one standard deviation of one geometric quantity does to torques, or to a sensor.

    Attributes:
        name: what is off, such as 'upper_arm' (of all limbs alike), 'strut of limb 2',
            'zero of drive1', 'tilt about x'.
        effect: the torques that the machine has more than the description says, or what its
            sensor shows more [N m or N].
    """

    name: str
    effect: Shown


@runtime_checkable
class Slopes(Protocol):
    """Slopes of torques, or of what a sensor shows, along a motion whose q has been measured."""

    @property
    def numbers(self) -> dict[str, tuple[int, ...]]:
        """Numbers of each kind of length, one a limb or one for all."""
        ...

    def of_length(self, number: int) -> Shown:
        """By a length [1/m]."""
        ...

    def of_zero(self, drive: int) -> Shown:
        """By a drive's zero [1/rad or 1/m]."""
        ...

    def of_gravity(self, axis: Float[np.ndarray, " 3"]) -> Shown:
        """By a turn of gravity about an axis [1/rad]."""
        ...


def geometric_errors(
    dynamics: Dynamics,
    z: Samples,
    qd: Samples,
    qdd: Samples,
    p: Parameters,
    tolerances: Tolerances | None = None,
) -> tuple[Error, ...]:
    """What each tolerance, by default of the description, does to the torques of a motion.

    Friction's steps have no slope and are left out, as is friction that depends on load.
    """
    grown, robot = grown_torques(dynamics.robot), dynamics.robot
    smooth, layout = p.copy(), dynamics.layout
    smooth[layout.friction] = 0.0
    smooth[layout.viscous] = p[layout.viscous]
    slopes = TorqueSlopes(grown, z, np.hstack([qd, qdd]), smooth, np.array(robot.gravity))
    return errors_by(robot, slopes, tolerances)


def errors_by(
    robot: RobotDescription, slopes: Slopes, tolerances: Tolerances | None = None
) -> tuple[Error, ...]:
    """Each tolerance, by default of the description, with what it does if it does anything."""
    by = tolerances or robot.tolerances
    lengths, zeros = _of_lengths(robot, by, slopes), _of_zeros(robot, by, slopes)
    found = (*lengths, *zeros, *_of_gravity(robot, by, slopes))
    return tuple(one for one in found if one.effect.any())


@dataclass(frozen=True, eq=False)
class TorqueSlopes:
    """Of torques, by differences of `GrownTorques`."""

    grown: "GrownTorques"
    z: Samples
    rates: Float[np.ndarray, "samples rates"]
    p: Parameters
    gravity: Float[np.ndarray, " 3"]

    @property
    def numbers(self) -> dict[str, tuple[int, ...]]:
        return self.grown.numbers

    @cached_property
    def _described(self) -> Shown:
        return self._torque(self.z)

    def of_length(self, number: int) -> Shown:
        """dτ/dg of a symbol of the growth [N m/m]."""
        z, grown = self._places.with_length(number)
        return (self._torque(z, grown) - self._described) / STEP

    def of_zero(self, drive: int) -> Shown:
        """dτ/dq_i at the same speeds and accelerations [N m/rad]."""
        return (self._torque(self._places.with_zero(drive)) - self._described) / STEP

    @cached_property
    def _places(self) -> "Places":
        return Places(self.grown.position, self.z, self.grown.symbols)

    def of_gravity(self, axis: Float[np.ndarray, " 3"]) -> Shown:
        """Change of torques as gravity turns about an axis [N m/rad]."""
        more = self.gravity + np.cross(axis, self.gravity)
        return self._torque(self.z, gravity=more) - self._described

    def _torque(
        self,
        z: Samples,
        grown: Float[np.ndarray, " growth"] | None = None,
        gravity: Float[np.ndarray, " 3"] | None = None,
    ) -> Shown:
        growth = np.zeros(self.grown.symbols) if grown is None else grown
        g = self.gravity if gravity is None else gravity
        return np.array(self.grown.torque(z.T, self.rates.T, self.p, growth, g))


@dataclass(frozen=True, eq=False)
class Places:
    """Where a robot is that has measured some q, if a length or a zero is `STEP` more.

    Attributes:
        position: q and J as functions of z and growth.
        z: where it would be as described.
        symbols: how many lengths may grow.
    """

    position: ca.Function
    z: Samples
    symbols: int

    def with_length(self, number: int) -> tuple[Samples, Float[np.ndarray, " growth"]]:
        """z and the growth."""
        grown, (q, J) = STEP * np.eye(self.symbols)[number], self._described
        later = np.array(self.position(self.z.T, grown)[0]).T
        return self.z - np.linalg.solve(J, (later - q)[:, :, None])[:, :, 0], grown

    def with_zero(self, drive: int) -> Samples:
        """z."""
        _, J = self._described
        along = np.linalg.solve(J, np.eye(J.shape[1])[:, [drive]])[:, :, 0]
        return self.z + STEP * along

    @cached_property
    def _described(self) -> tuple[Samples, Float[np.ndarray, "samples dof dof"]]:
        """q and J."""
        q, J = self.position(self.z.T, np.zeros(self.symbols))
        dof = self.z.shape[1]
        blocks = np.array(J).reshape(dof, -1, dof).swapaxes(0, 1)
        return np.array(q).T, blocks


def _of_lengths(robot: RobotDescription, by: Tolerances, slopes: Slopes) -> Iterator[Error]:
    """A number that all limbs share may be wrong, and each limb may differ from it."""
    found: dict[int, Shown] = {}  # base and platform share theirs
    for name, numbers in slopes.numbers.items():
        size = by.of_length(name)
        if not size:
            continue
        found |= {k: slopes.of_length(k) for k in numbers if k not in found}
        # A drive further out does what a joint of the platform further in does.
        each = [(-size if name == "base_radius" else size) * found[k] for k in numbers]
        if len(each) == 1 or not isinstance(getattr(robot.limbs, name), tuple):
            yield Error(name, np.sum(each, axis=0))
        if len(each) > 1:
            for i, effect in enumerate(each):
                yield Error(f"{name} of limb {i + 1}", effect)


def _of_zeros(robot: RobotDescription, by: Tolerances, slopes: Slopes) -> Iterator[Error]:
    for i, drive in enumerate(robot.drives):
        size = by.of_drive(drive)
        if size:
            yield Error(f"zero of {drive}", size * slopes.of_zero(i))


def _of_gravity(robot: RobotDescription, by: Tolerances, slopes: Slopes) -> Iterator[Error]:
    size = by.mounting
    for axis in across(np.array(robot.gravity)) if size else ():
        yield Error(f"tilt about {np.round(axis, 3).tolist()}", size * slopes.of_gravity(axis))


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


def grown_torques(robot: RobotDescription) -> "GrownTorques":
    """Torques and drive coordinates of a robot that may grow, kept for the next call."""
    return _grown(robot.model_dump_json())


class GrownDynamics(Dynamics):
    """A robot whose lengths exceed those described by symbols."""

    def __init__(self, robot: RobotDescription) -> None:
        super().__init__(robot)
        growth = Growth.named(len(robot.limb_geometry))
        self.growth: ca.SX = growth.symbols
        self.kinematics.mechanism = build_mechanism(robot, growth)


@lru_cache(maxsize=4)
def _grown(description: str) -> GrownTorques:
    robot, gravity = RobotDescription.model_validate_json(description), ca.SX.sym("g", 3)
    growth = Growth.named(len(robot.limb_geometry))
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


def across(g: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "axes 3"]:
    """Two axes to turn gravity about."""
    if not g.any():
        return np.zeros((0, 3))
    third = np.argmin(np.abs(g))
    first = np.cross(g, np.eye(3)[third])
    first /= np.linalg.norm(first)
    second = np.cross(g, first)
    return np.stack([first, second / np.linalg.norm(second)])
