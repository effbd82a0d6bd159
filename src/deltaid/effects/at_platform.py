"""Forces at the platform that a description lacks, of a hose, a cable or a spring.

    F = f − K (x − x_0) − d v/|v| − c v,    τ = Y p − J_xᵀ F,    J_x = ∂x/∂q

with the place x of the platform, its velocity v, and its home x_0.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.along_motion import (
    WITHOUT,
    AlongMotion,
    DriveSpring,
    FittedTorques,
    InTask,
    RippleColumns,
)
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction, FittedEffect
from deltaid.model.parameter_record import Parameter

# Velocities below this share of the largest have no direction yet.
_STILL = 0.01

InWorld = Float[np.ndarray, "samples 3"]
Forces = Float[np.ndarray, "columns samples 3"]


@dataclass(frozen=True, eq=False)
class AtPlatform(AlongMotion):
    """A force at the platform."""

    deviation: tuple[float, ...]  # prior standard deviation of each coefficient
    fastest: float  # largest speed of the platform [m/s]

    kind = "platform-force"
    units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def forces(self, x: InWorld, v: InWorld) -> Forces:
        """F for a coefficient of 1, one after the other."""

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        rows = zip(self.symbols, self.units, self.deviation, strict=True)
        return [("platform", *row) for row in rows]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives, count = np.arange(self.dynamics.dof), len(self.symbols)
        return np.tile(drives, count), np.repeat(np.arange(count), len(drives))

    def of_motion(self, z: InTask, qd: InTask) -> Values:
        T, home = self.dynamics.kinematics.platform_jacobian(z), self.dynamics.kinematics.home
        x = self.dynamics.robot.task.point(z) - self.dynamics.robot.task.point(home)
        along = np.ascontiguousarray(T.transpose(1, 2, 0))
        forces = self.forces(x, np.sum(along * qd.T, axis=1).T).transpose(0, 2, 1)
        torques = sum(forces[:, None, i] * along[i] for i in range(3))
        return -np.reshape(torques, (-1, len(z)))

    def record(self, values: tuple[float, ...]) -> FittedEffect:
        return FittedEffect(name=self.name, values=values, fastest=self.fastest)

    def correction(
        self, value: float, judged: Sequence[Parameter], unit: str, text: str
    ) -> tuple[Correction, ...]:
        """Its size, with the largest half width of an interval."""
        ends = [(x.low, x.high) for x in judged if x.low is not None and x.high is not None]
        half = max((high - low) / 2 for low, high in ends)
        return (
            Correction(kind=self.kind, subject="platform", value=value, low=value - half,
                       high=value + half, unit=unit, text=f"{text}; {WITHOUT}"),
        )  # fmt: skip


class ConstantForce(AtPlatform):
    """f: a force that is the same everywhere."""

    name = "platform-force"
    symbols = ("Fx", "Fy", "Fz")
    units = ("N",) * 3

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return np.eye(3)[:, None, :] * np.ones((len(x), 1))

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        f = np.array([entry.value for entry in judged])
        way = ", ".join(f"{share:.2f}" for share in f / max(np.linalg.norm(f), 1e-300))
        text = f"a constant force pulls at the platform along ({way}), as a hose or cable does"
        return self.correction(float(np.linalg.norm(f)), judged, "N", text)


class PlatformSpring(AtPlatform):
    """K: a force that grows with the way from home, in any direction."""

    name = "platform-spring"
    symbols = tuple(f"K{i}{j}" for i in "xyz" for j in "xyz")
    units = ("N/m",) * 9

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return -np.einsum("ik,sj->ijsk", np.eye(3), x).reshape(9, len(x), 3)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        K = np.array([entry.value for entry in judged]).reshape(3, 3)
        text = "a spring pulls the platform back, as a hose, a cable or a balancer does"
        return self.correction(float(np.trace(K)) / 3, judged, "N/m", text)


class Drag(AtPlatform):
    """d, c: a force against the velocity, constant or in proportion to it."""

    name = "platform-drag"
    symbols = ("d", "c")
    units = ("N", "N s/m")

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        speed = np.hypot(np.linalg.norm(v, axis=1), _STILL * self.fastest)
        return -np.stack([v / speed[:, None], v])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        text = "something drags at the platform against its motion, as a hose or cable does"
        return self.correction(judged[0].value, judged[:1], "N", text)


FORCES: tuple[type[AtPlatform], ...] = (ConstantForce, PlatformSpring, Drag)


def platform_forces(dynamics: Dynamics, fastest: float) -> tuple[AtPlatform, ...]:
    """Each force with a prior of 1 in its units."""
    return tuple(force(dynamics, (1.0,) * len(force.symbols), fastest) for force in FORCES)


def as_fitted(dynamics: Dynamics, record: FittedEffect) -> FittedTorques:
    """An effect of a model file."""
    names, deviation = dynamics.robot.drives, (1.0,) * len(record.values)
    drives = tuple(names.index(drive) for drive in record.drives)
    if record.name == RippleColumns.name:
        return FittedTorques(
            RippleColumns(dynamics, drives, deviation, record.orders), record.values
        )
    if record.name == DriveSpring.name:
        return FittedTorques(DriveSpring(dynamics, drives, deviation), record.values)
    force = next(force for force in FORCES if force.name == record.name)
    return FittedTorques(force(dynamics, deviation, record.fastest), record.values)
