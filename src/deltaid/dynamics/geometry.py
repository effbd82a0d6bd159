"""Slopes of torques by a robot's lengths, its drives' zeros and the direction of gravity.

A recording fixes the drive coordinates q, not z. With torques τ(z, q̇, q̈; g) and coordinates
q(z; g) as functions of lengths g, and J = ∂q/∂z,

    dτ/dg = ∂τ/∂g − ∂τ/∂z J⁻¹ ∂q/∂g,    dτ/dq_0 = ∂τ/∂z J⁻¹.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.joint_columns import joint_columns
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.kernel.batch import BatchKernel, RowKernel
from deltaid.mechanism.composition import build_mechanism
from deltaid.mechanism.growth import LengthGrowth, grown_by
from deltaid.mechanism.kinematics import Samples
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

# Difference step of lengths [m], of zeros [rad or m] and of gravity's direction [rad]: far above
# rounding, and so small that no other joint reverses within it.
_STEP = 1e-6
# Names of the common error of all torque constants and of each drive's error.
CONSTANTS, CONSTANT_OF = "torque constants", "torque constant of"

# Torques of all drives, or channels of a sensor, at some samples.
Shown = Float[np.ndarray, "channels samples"]


@dataclass(frozen=True, eq=False)
class GrownTorques:
    """Torques and drive coordinates of a robot as functions of its lengths and of gravity.

    Attributes:
        numbers: indices of the symbols of each kind of length.
        symbols: number of symbols.
    """

    numbers: dict[str, tuple[int, ...]]
    symbols: int
    _torque: BatchKernel
    _position: RowKernel

    def torque(
        self,
        z: Samples,
        rates: Float[np.ndarray, "samples rates"],
        p: Parameters,
        growth: Float[np.ndarray, " growth"],
        gravity: Float[np.ndarray, " 3"],
    ) -> Shown:
        """τ along a motion with `rates` [q̇, q̈]."""
        return self._torque(np.hstack([z, rates]).T, np.concatenate([p, growth, gravity]))

    def position(
        self, z: Samples, growth: Float[np.ndarray, " growth"]
    ) -> tuple[Samples, Float[np.ndarray, "samples dof dof"]]:
        """Drive coordinates q and J = ∂q/∂z."""
        q, J = self._position.rows(z, uniform=growth)
        return q, J


def grown_torques(robot: RobotDescription, mounted: bool = False) -> GrownTorques:
    """Torques and drive coordinates of a robot with symbolic lengths, cached; `mounted` adds those
    of the limbs' mounting."""
    return _grown(robot.model_dump_json(), mounted)


class GrownDynamics(Dynamics):
    """Dynamics of a robot whose lengths exceed the described ones by symbols."""

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
    forces, speeds = SpeedForces(robot, mechanism, gravity), mechanism.speeds
    motion, still = speeds.by_drives(), ca.SX.zeros(mechanism.dof)
    joints = (
        forces.joint_columns(joint_columns(robot), still) @ forces.p[forces.layout.coefficients]
    )
    torque = speeds.drives_to_all.T @ motion(forces.of_bodies() + joints)
    rates, uniform = ca.vertcat(speeds.q.u, speeds.q.ud), ca.vertcat(forces.p, symbols, gravity)
    return GrownTorques(
        grown_by(robot),
        symbols.numel(),
        BatchKernel(ca.vertcat(mechanism.z, rates), torque, uniform),
        RowKernel([mechanism.z], [mechanism.q, ca.horzsplit(speeds.jacobian)], symbols),
    )


@dataclass(frozen=True, eq=False)
class Error:
    """Effect of one standard deviation of a geometric quantity on torques, or on a sensor.

    Attributes:
        name: the wrong quantity, such as 'upper_arm' (the same error in all limbs), 'strut of
            limb 2', 'zero of drive1', 'tilt about x'.
        effect: torques or sensor readings of the machine less those of the description [N m or N].
    """

    name: str
    effect: Shown


@dataclass(frozen=True, eq=False)
class GeometrySlopes(ABC):
    """Slopes of torques, or of a sensor, along a motion with measured q, by differences.

    Attributes:
        grown: the robot with symbolic lengths.
        z: the motion as described.
        rates: q̇, q̈.
        gravity: as described [m/s²].
    """

    grown: GrownTorques
    z: Samples
    rates: Float[np.ndarray, "samples rates"]
    gravity: Float[np.ndarray, " 3"]

    @abstractmethod
    def shown(
        self,
        z: Samples,
        rates: Float[np.ndarray, "samples rates"],
        growth: Float[np.ndarray, " growth"],
        gravity: Float[np.ndarray, " 3"],
    ) -> Shown:
        """Torques, or readings of the sensor."""

    def of_length(self, number: int) -> Shown:
        """Slope by one symbol of a length [1/m]."""
        return self.of_growth(np.eye(self.grown.symbols)[number])

    def of_growth(self, direction: Float[np.ndarray, " growth"]) -> Shown:
        """Slope along a direction in the space of all symbols [1/m or 1/rad]."""
        growth, (q, J) = _STEP * direction, self._drives
        later = self.grown.position(self.z, growth)[0]
        z = self.z - np.linalg.solve(J, (later - q)[:, :, None])[:, :, 0]
        return (self.shown(z, self.rates, growth, self.gravity) - self._described) / _STEP

    def of_zero(self, drive: int) -> Shown:
        """Slope by a drive's zero, at the same speeds and accelerations [1/rad or 1/m]."""
        moved, still = np.zeros_like(self.z), np.zeros_like(self.z)
        moved[:, drive] = 1.0
        return self.of_motion(moved, still, still)

    def of_motion(self, q: Samples, qd: Samples, qdd: Samples) -> Shown:
        """Slope by a change of the drives' positions, speeds and accelerations, per unit change."""
        z = self.z + _STEP * np.linalg.solve(self._drives[1], q[:, :, None])[:, :, 0]
        rates = self.rates + _STEP * np.hstack([qd, qdd])
        return (self.shown(z, rates, self._no_growth, self.gravity) - self._described) / _STEP

    def of_gravity(self, axis: Float[np.ndarray, " 3"]) -> Shown:
        """Slope by a turn of gravity about an axis [1/rad]."""
        turned = self.gravity + np.cross(axis, self.gravity)
        return self.shown(self.z, self.rates, self._no_growth, turned) - self._described

    @property
    def _no_growth(self) -> Float[np.ndarray, " growth"]:
        return np.zeros(self.grown.symbols)

    @cached_property
    def _described(self) -> Shown:
        return self.shown(self.z, self.rates, self._no_growth, self.gravity)

    @cached_property
    def _drives(self) -> tuple[Samples, Float[np.ndarray, "samples dof dof"]]:
        """Drive coordinates q and J = ∂q/∂z as described."""
        return self.grown.position(self.z, self._no_growth)


@dataclass(frozen=True, eq=False)
class TorqueSlopes(GeometrySlopes):
    """Slopes of torques with parameters p [N m/m, N m/rad, …].

    Attributes:
        p: parameters; of friction only the viscous terms.
        dry: for each passive joint a vector of its other friction terms. This friction keeps its
            direction, but its effect on the drives changes with the joint's position.
    """

    p: Parameters
    dry: tuple[Parameters, ...] = ()

    def shown(
        self,
        z: Samples,
        rates: Float[np.ndarray, "samples rates"],
        growth: Float[np.ndarray, " growth"],
        gravity: Float[np.ndarray, " 3"],
    ) -> Shown:
        torque = self.grown.torque(z, rates, self.p, growth, gravity)
        for p, before in zip(self.dry, self._dry_as_described, strict=True):
            after = self.grown.torque(z, rates, p, growth, gravity)
            torque += np.sign(np.sum(before * after, axis=0)) * after
        return torque

    @cached_property
    def _dry_as_described(self) -> list[Shown]:
        growth, gravity = self._no_growth, self.gravity
        return [self.grown.torque(self.z, self.rates, p, growth, gravity) for p in self.dry]


def geometric_errors(
    dynamics: Dynamics,
    z: Samples,
    qd: Samples,
    qdd: Samples,
    p: Parameters,
    tolerances: Tolerances | None = None,
) -> tuple[Error, ...]:
    """Effect of each tolerance, by default the description's, on the torques of a motion.

    Friction keeps its direction; load-dependent friction is excluded.
    """
    robot, torque = dynamics.robot, dynamics.torque(z, qd, qdd, p).T
    return (
        *errors_by(robot, torque_slopes(dynamics, z, qd, qdd, p), tolerances),
        *_of_constants(robot, tolerances or robot.tolerances, torque),
    )


def errors_by(
    robot: RobotDescription, slopes: GeometrySlopes, tolerances: Tolerances | None = None
) -> tuple[Error, ...]:
    """Tolerances, by default the description's, with their effects; those without effect are
    dropped."""
    by = tolerances or robot.tolerances
    zeros = [
        Error(f"zero of {drive}", size * slopes.of_zero(i))
        for i, drive in enumerate(robot.drives)
        if (size := by.of_drive(drive))
    ]
    tilts = [
        Error(f"tilt about {np.round(axis, 3).tolist()}", by.mounting * slopes.of_gravity(axis))
        for axis in (across(slopes.gravity) if by.mounting else ())
    ]
    errors = (*_of_lengths(robot, by, slopes), *zeros, *tilts)
    return tuple(error for error in errors if error.effect.any())


def torque_slopes(
    dynamics: Dynamics, z: Samples, qd: Samples, qdd: Samples, p: Parameters
) -> TorqueSlopes:
    """Slopes of torques along a motion; friction keeps its direction."""
    robot, layout, smooth = dynamics.robot, dynamics.layout, p.copy()
    smooth[layout.friction] = 0.0
    smooth[layout.viscous] = p[layout.viscous]
    owners = np.array([parameter.owner for parameter in layout.parameters])
    passive = [joint for joint in robot.friction_joints if joint not in robot.drives]
    dry = tuple(np.where(owners == joint, p - smooth, 0.0) for joint in passive)
    rates, gravity = np.hstack([qd, qdd]), np.array(robot.gravity)
    return TorqueSlopes(grown_torques(robot), z, rates, gravity, smooth, dry)


def _of_lengths(robot: RobotDescription, by: Tolerances, slopes: GeometrySlopes) -> Iterator[Error]:
    """Errors of a length: one that all limbs share, and one of each limb."""
    by_symbol: dict[int, Shown] = {}  # base and platform share their tolerance
    for name, numbers in slopes.grown.numbers.items():
        size = by.of_length(name)
        if not size:
            continue
        by_symbol |= {k: slopes.of_length(k) for k in numbers if k not in by_symbol}
        # A drive moved outwards equals a joint of the platform moved inwards.
        each = [(-size if name == "base_radius" else size) * by_symbol[k] for k in numbers]
        if len(each) == 1 or not isinstance(getattr(robot.limbs, name), tuple):
            yield Error(name, np.sum(each, axis=0))
        if len(each) > 1:
            for i, effect in enumerate(each):
                yield Error(f"{name} of limb {i + 1}", effect)


def _of_constants(robot: RobotDescription, by: Tolerances, torque: Shown) -> Iterator[Error]:
    """Errors of torque constants: a common one, and one of each drive."""
    if not by.torque_constants:
        return
    yield Error(CONSTANTS, by.torque_constants * torque)
    for i, drive in enumerate(robot.drives):
        own = np.zeros_like(torque)
        own[i] = by.torque_constants * torque[i]
        yield Error(f"{CONSTANT_OF} {drive}", own)


def across(g: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "axes 3"]:
    """Two axes perpendicular to gravity."""
    if not g.any():
        return np.zeros((0, 3))
    first = np.cross(g, np.eye(3)[np.argmin(np.abs(g))])
    first /= np.linalg.norm(first)
    second = np.cross(g, first)
    return np.stack([first, second / np.linalg.norm(second)])
