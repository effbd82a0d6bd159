"""How torques change with a robot's lengths, its drives' zeros and the direction of gravity.

A recording has drive coordinates q, whatever the geometry is. With torques τ(z, q̇, q̈; g) and
coordinates q(z; g) of lengths g, and J = ∂q/∂z,

    dτ/dg = ∂τ/∂g − ∂τ/∂z J⁻¹ ∂q/∂g,    dτ/dq_0 = ∂τ/∂z J⁻¹.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.grown import STEP, GrownPoses, GrownTorques, grown_torques
from deltaid.mechanism.kinematics import Samples
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

# Names of what is common to torque constants, and of one drive's.
CONSTANTS, CONSTANT_OF = "torque constants", "torque constant of"

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
class GeometrySlopes(Protocol):
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
    torque = dynamics.torque(z, qd, qdd, p).T
    return (
        *errors_by(robot, slopes, tolerances),
        *_of_constants(robot, tolerances or robot.tolerances, torque),
    )


def errors_by(
    robot: RobotDescription, slopes: GeometrySlopes, tolerances: Tolerances | None = None
) -> tuple[Error, ...]:
    """Each tolerance, by default of the description, with what it does if it does anything."""
    by = tolerances or robot.tolerances
    lengths, zeros = _of_lengths(robot, by, slopes), _of_zeros(robot, by, slopes)
    found = (*lengths, *zeros, *_of_gravity(robot, by, slopes))
    return tuple(error for error in found if error.effect.any())


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
        return self.of_growth(np.eye(self.grown.symbols)[number])

    def of_growth(self, direction: Float[np.ndarray, " growth"]) -> Shown:
        """Along a direction of the symbols of the growth [N m/m or N m/rad]."""
        z, grown = self._places.with_growth(direction)
        return (self._torque(z, grown) - self._described) / STEP

    def of_zero(self, drive: int) -> Shown:
        """dτ/dq_i at the same speeds and accelerations [N m/rad]."""
        return (self._torque(self._places.with_zero(drive)) - self._described) / STEP

    def of_motion(self, q: Samples, qd: Samples, qdd: Samples) -> Shown:
        """By a change of the drives' positions, speeds and accelerations, per unit of it."""
        rates = self.rates + STEP * np.hstack([qd, qdd])
        return (self._torque(self._places.with_drives(q), rates=rates) - self._described) / STEP

    @cached_property
    def _places(self) -> "GrownPoses":
        return GrownPoses(self.grown.position, self.z, self.grown.symbols)

    def of_gravity(self, axis: Float[np.ndarray, " 3"]) -> Shown:
        """Change of torques as gravity turns about an axis [N m/rad]."""
        more = self.gravity + np.cross(axis, self.gravity)
        return self._torque(self.z, gravity=more) - self._described

    def _torque(
        self,
        z: Samples,
        grown: Float[np.ndarray, " growth"] | None = None,
        gravity: Float[np.ndarray, " 3"] | None = None,
        rates: Float[np.ndarray, "samples rates"] | None = None,
    ) -> Shown:
        growth = np.zeros(self.grown.symbols) if grown is None else grown
        g = self.gravity if gravity is None else gravity
        u = self.rates if rates is None else rates
        return np.array(self.grown.torque(z.T, u.T, self.p, growth, g))


def _of_lengths(robot: RobotDescription, by: Tolerances, slopes: GeometrySlopes) -> Iterator[Error]:
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


def _of_zeros(robot: RobotDescription, by: Tolerances, slopes: GeometrySlopes) -> Iterator[Error]:
    for i, drive in enumerate(robot.drives):
        size = by.of_drive(drive)
        if size:
            yield Error(f"zero of {drive}", size * slopes.of_zero(i))


def _of_constants(robot: RobotDescription, by: Tolerances, torque: Shown) -> Iterator[Error]:
    """What drives record more, all alike and each."""
    if not by.torque_constants:
        return
    yield Error(CONSTANTS, by.torque_constants * torque)
    for i, drive in enumerate(robot.drives):
        own = np.zeros_like(torque)
        own[i] = by.torque_constants * torque[i]
        yield Error(f"{CONSTANT_OF} {drive}", own)


def _of_gravity(robot: RobotDescription, by: Tolerances, slopes: GeometrySlopes) -> Iterator[Error]:
    size = by.mounting
    for axis in across(np.array(robot.gravity)) if size else ():
        yield Error(f"tilt about {np.round(axis, 3).tolist()}", size * slopes.of_gravity(axis))


def across(g: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "axes 3"]:
    """Two axes to turn gravity about."""
    if not g.any():
        return np.zeros((0, 3))
    third = np.argmin(np.abs(g))
    first = np.cross(g, np.eye(3)[third])
    first /= np.linalg.norm(first)
    second = np.cross(g, first)
    return np.stack([first, second / np.linalg.norm(second)])
