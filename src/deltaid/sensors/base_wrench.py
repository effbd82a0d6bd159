"""A six-axis sensor under the base: rows of the force and moment that it exerts on the robot.

Springs, friction and loop closures are internal and cancel. The sensor carries the inertial and
gravity forces of all moving bodies,

    f = Σ (m a + …),    μ = Σ (moment about the link frame + (r − o) × force),

about its origin o, from `dynamics.speed_forces.wrench`. A rotor with the reflected inertia I turns
n times as fast as its drive: its inertia is I/n², its spin I/n q̇ about the drive's axis, and the
base exerts I/n q̈ on it. For a rail n is 2π times the spindle's turns per metre, about the rail's
direction.

With an origin that is off by δ and axes turned by θ, both in the sensor's axes, it measures

    f + f × θ,    μ + μ × θ + f × δ.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.force_parts import LoadedBody
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.errors import DescriptionError
from deltaid.mechanism.rotation import fixed
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import BaseWrench
from deltaid.sensors.rows import SensorRows, Shown, Unknown, wide_force, wide_moment
from deltaid.sensors.weighings import rotation

_AXES = "xyz"
_FORCES, _MOMENTS = (0, 1, 2), (3, 4, 5)
# A rotor whose n is unknown: drive, symbol, and moment on the base in the world for I/n q̈ = 1.
_Spin = tuple[str, str, Float[np.ndarray, " 3"]]


@dataclass(frozen=True, eq=False)
class BaseWrenchRows(SensorRows):
    """Rows of one base wrench sensor.

    Raises:
        DescriptionError: a motor with no turns, or turns given for motors of a user's own
            mechanism, whose axes are unknown.
    """

    sensor: BaseWrench

    def __post_init__(self) -> None:
        given = [n for n in map(self._turns, self.dynamics.robot.rotor_drives) if n is not None]
        where = f"sensors.{self.name}.motor_turns"
        if given and self.dynamics.robot.mechanism is not None:
            raise DescriptionError(
                "a mechanism of your own does not say about which axes its motors turn",
                where=where,
                cure="leave it out; what rotors do to the base is identified then",
            )
        if 0.0 in given:
            raise DescriptionError(
                "a motor that makes no turn moves nothing",
                where=where,
                cure="give the ratio of its gear, 1 for a direct drive; or leave it out",
            )

    @property
    def graph(self) -> ca.SX:
        robot, mechanism = self.dynamics.robot, self.dynamics.kinematics.mechanism
        forces, origin = SpeedForces(robot, mechanism), ca.SX(ca.DM(self.sensor.position))
        force, moment = ca.SX(3, 1), ca.SX(3, 1)
        for body in mechanism.bodies:
            part = LoadedBody(body, forces.wrench(body))
            f = ca.densify(part.world_force)
            force += body.count * f
            moment += body.count * (part.world_moment + ca.cross(body.world_origin - origin, f))
        columns = ca.jacobian(ca.vertcat(force, moment), forces.p)
        columns[3:, :] += self._rotors()
        accelerations = mechanism.speeds.q.ud
        spins = [fixed(axis) * accelerations[self._index(drive)] for drive, _, axis in self._spins]
        extra = ca.vertcat(ca.SX(3, len(spins)), ca.horzcat(ca.SX(3, 0), *spins))
        R = fixed(rotation(self.sensor.rotation_deg).T)
        return mechanism.speeds.by_drives()(ca.diagcat(R, R) @ ca.horzcat(columns, extra))

    @property
    def moving(self) -> tuple[PriorParameter, ...]:
        """I/n of each rotor whose n is unknown; its prior deviation is I, as of a direct drive, or
        I/2π of a rail."""
        robot = self.dynamics.robot

        def spin(drive: str, symbol: str) -> PriorParameter:
            inertia, rail = robot.rotor_inertia[drive], robot.is_linear(drive)
            std = inertia / (2 * np.pi) if rail else inertia
            return self.unknown(symbol, "kg m" if rail else "kg m²", std)

        return tuple(spin(drive, symbol) for drive, symbol, _ in self._spins)

    @cached_property
    def still(self) -> tuple[Unknown, ...]:
        s, (force, moment) = self.sensor, (self.sensor.force_bias, self.sensor.moment_bias)
        force = wide_force(self.dynamics) if force is None else force
        moment = wide_moment(self.dynamics, np.array(s.position)) if moment is None else moment
        names = (channel.name.rpartition(".")[2] for channel in self.channels)
        biases = zip(names, [force] * 3 + [moment] * 3, strict=True)
        return (
            *(bias for k, (x, std) in enumerate(biases) for bias in self.bias(k, f"{x}_bias", std)),
            *self._off("position", "m", s.position_tolerance, _FORCES),
            *self._off("rotation", "rad", s.rotation_tolerance, _FORCES + _MOMENTS),
            *self.gain(s.gain_tolerance),
        )

    def _off(self, symbol: str, unit: str, std: float, what: tuple[int, ...]) -> Iterator[Unknown]:
        """Yield pose errors along each axis j with columns v × e_j; none where std is zero.

        Args:
            what: channels v: forces for a position error, which changes moments; all for a rotation
                error.
        """
        starts, moved = range(0, len(what), 3), 3 if len(what) == 3 else 0
        for j, axis in enumerate(_AXES if std else ""):
            k, l = (j + 1) % 3, (j + 2) % 3  # v × e_j has v_l along k and −v_k along l

            def column(shown: Shown, k: int = k, l: int = l) -> np.ndarray:
                return np.vstack([row for s in starts for row in (shown[s + l], -shown[s + k])])

            yield Unknown(
                self.unknown(f"{symbol}_{axis}", unit, std),
                channels=tuple(moved + s + i for s in starts for i in (k, l)),
                column=column,
            )

    def _rotors(self) -> ca.SX:
        """Columns over p of the moments on the base, in the world, by rotors whose n is known."""
        robot, layout = self.dynamics.robot, self.dynamics.layout
        accelerations = self.dynamics.kinematics.mechanism.speeds.q.ud
        columns = ca.SX(3, len(layout.parameters))
        for k, drive in enumerate(robot.rotor_drives, start=layout.rotor.start):
            n = self._turns(drive)
            if n is not None:
                speed = 2 * np.pi * n if robot.is_linear(drive) else n
                columns[:, k] = fixed(self._axis(drive)) / speed * accelerations[self._index(drive)]
        return columns

    @cached_property
    def _spins(self) -> tuple[_Spin, ...]:
        drives = self.dynamics.robot.rotor_drives
        if self.dynamics.robot.mechanism is not None:
            axes = list(zip(_AXES, np.eye(3), strict=True))
            return tuple((drive, f"spin_{x}_{drive}", e) for drive in drives for x, e in axes)
        free = [drive for drive in drives if self._turns(drive) is None]
        return tuple((drive, f"spin_{drive}", self._axis(drive)) for drive in free)

    def _axis(self, drive: str) -> Float[np.ndarray, " 3"]:
        """Axis of a described robot's drive in the world; for a rail, its direction."""
        limbs, i = self.dynamics.robot.limb_geometry, self._index(drive)
        if i >= len(limbs):
            return np.array([0.0, 0.0, 1.0])
        limb = limbs[i]
        return limb.R_WL @ limb.rail if limb.drive == "linear" else limb.R_WL[:, 1]

    def _index(self, drive: str) -> int:
        return self.dynamics.robot.drives.index(drive)

    def _turns(self, drive: str) -> float | None:
        """n of a drive, None where unknown."""
        turns = self.sensor.motor_turns
        return turns.get(drive) if isinstance(turns, dict) else turns
