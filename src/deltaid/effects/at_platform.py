"""Torques of a force at the platform that a description lacks, as of a hose, a cable or a spring:

    F = f − K (x − x_0) − d v/|v| − c v,    τ = Y p − J_xᵀ F,    J_x = ∂x/∂q

with the place x of the platform, its velocity v, and its home x_0.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.along_motion import AlongMotion, InTask
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.masks.masks import RESTS

InWorld = Float[np.ndarray, "samples 3"]
Forces = Float[np.ndarray, "columns samples 3"]


class AtPlatform(AlongMotion):
    """A force at the platform."""

    kind = "platform-force"
    units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def forces(self, x: InWorld, v: InWorld) -> Forces:
        """F of each coefficient when it is 1 and the others are 0."""

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        rows = zip(self.symbols, self.units, self.deviation, strict=True)
        return [("platform", *row) for row in rows]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives, count = np.arange(self.dynamics.dof), len(self.symbols)
        return np.tile(drives, count), np.repeat(np.arange(count), len(drives))

    def of_motion(self, z: InTask, qd: InTask, qdd: InTask) -> Values:
        T, home = self.dynamics.kinematics.platform_jacobian(z), self.dynamics.kinematics.home
        x = self.dynamics.robot.task.point(z) - self.dynamics.robot.task.point(home)
        along = np.ascontiguousarray(T.transpose(1, 2, 0))
        forces = self.forces(x, np.sum(along * qd.T, axis=1).T).transpose(0, 2, 1)
        torques = sum(forces[:, None, i] * along[i] for i in range(3))
        return -np.reshape(torques, (-1, len(z)))

    def pull(self, judged: Sequence[Parameter], what: str) -> Correction:
        """A correction by a force at home with these components."""
        f = np.array([entry.value for entry in judged])
        way = ", ".join(f"{share:.2f}" for share in f / max(np.linalg.norm(f), 1e-300))
        text = f"{what} pulls at the platform along ({way}), as a hose or cable does"
        return self.correction("platform", float(np.linalg.norm(f)), judged, "N", text)


class ConstantForce(AtPlatform):
    """f: a force that is the same everywhere."""

    name = "platform-force"
    symbols = ("Fx", "Fy", "Fz")
    units = ("N",) * 3

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return np.eye(3)[:, None, :] * np.ones((len(x), 1))

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return (self.pull(judged, "a constant force"),)


class PlatformSpring(AtPlatform):
    """K = Kᵀ and f = K x_r: a force that grows with the distance from where the spring is relaxed,
    F = −K (x − x_r), as that of a potential."""

    name = "platform-spring"
    symbols = ("Kxx", "Kyy", "Kzz", "Kxy", "Kxz", "Kyz", "Fx", "Fy", "Fz")
    units = ("N/m",) * 6 + ("N",) * 3

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        along, across = np.eye(3), [(0, 1), (0, 2), (1, 2)]
        straight = [np.outer(x[:, i], along[i]) for i in range(3)]
        coupled = [np.outer(x[:, j], along[i]) + np.outer(x[:, i], along[j]) for i, j in across]
        relaxed = -along[:, None, :] * np.ones((len(x), 1))
        return -np.stack([*straight, *coupled, *relaxed])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        stiffness = float(np.mean([entry.value for entry in judged[:3]]))
        text = "a spring pulls the platform back, as a hose, a cable or a balancer does"
        stiff = self.correction("platform", stiffness, judged[:6], "N/m", text)
        return stiff, self.pull(judged[6:], "where the robot is at home, this spring")


class Drag(AtPlatform):
    """d, c: a force against the velocity, constant or in proportion to it."""

    name = "platform-drag"
    symbols = ("d", "c")
    units = ("N", "N s/m")

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        speed = np.hypot(np.linalg.norm(v, axis=1), RESTS * self.fastest)
        return -np.stack([v / speed[:, None], v])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        text = "something drags at the platform against its motion, as a hose or cable does"
        return (self.correction("platform", judged[0].value, judged[:1], "N", text),)


FORCES: tuple[type[AtPlatform], ...] = (ConstantForce, PlatformSpring, Drag)


def platform_forces(dynamics: Dynamics, fastest: float) -> tuple[AtPlatform, ...]:
    """Each force with a prior of 1 in its units."""
    return tuple(
        force(dynamics, (), (1.0,) * len(force.symbols), fastest=fastest) for force in FORCES
    )
