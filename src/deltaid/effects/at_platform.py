"""Torques of a force at the platform that a description lacks, as of a hose, a cable or a spring:

    F = f − K x − d v/|v| − c v,    τ = Y p − J_xᵀ F,    J_x = ∂x/∂q

with the platform's displacement x from home, its velocity v, and a symmetric stiffness K; and of a
taut cable, which pulls to one point.
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

    def pull(self, f: Float[np.ndarray, " 3"], judged: Sequence[Parameter]) -> Correction:
        """A correction by a force at home."""
        way = ", ".join(f"{share:.2f}" for share in f / max(np.linalg.norm(f), 1e-300))
        text = (f"where the robot is at home, a force pulls at the platform along ({way}), as a "
                "hose or cable does")  # fmt: skip
        pull = self.correction("platform", float(np.linalg.norm(f)), judged, "N", text)
        return pull.changed(kind="platform-force")


def _values(judged: Sequence[Parameter]) -> Float[np.ndarray, " coefficients"]:
    return np.array([entry.value for entry in judged])


def constant(x: InWorld) -> Forces:
    """Forces of 1 N along each axis."""
    return np.eye(3)[:, None, :] * np.ones((len(x), 1))


class ConstantForce(AtPlatform):
    """f: a force that is the same everywhere."""

    name = "platform-force"
    symbols = ("Fx", "Fy", "Fz")
    units = ("N",) * 3

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return constant(x)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return (self.pull(_values(judged), judged),)


class PlatformSpring(AtPlatform):
    """A part of f − K x."""

    kind = "platform-spring"
    text: ClassVar[str]

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        largest = max((entry.value for entry in judged), key=abs)
        return (self.correction("platform", largest, judged, "N/m", self.text),)


class IsotropicSpring(PlatformSpring):
    """K = k 1 and f = k x_r: as stiff in all directions, and relaxed at x_r."""

    name = "isotropic-spring"
    symbols = ("K", "Fx", "Fy", "Fz")
    units = ("N/m", "N", "N", "N")
    text = "a spring pulls the platform back, as a hose, a cable or a balancer does"

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return np.concatenate([-x[None], constant(x)])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return (*super().to_corrections(judged[:1]), self.pull(_values(judged[1:]), judged[1:]))


class AnisotropicSpring(PlatformSpring):
    """K = Kᵀ with the trace 0: stiffer in some directions than in others."""

    name = "anisotropic-spring"
    symbols = ("Kxx", "Kyy", "Kxy", "Kxz", "Kyz")
    units = ("N/m",) * 5
    text = "a spring, hose or cable at the platform is stiffer in some directions than in others"

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        along, across = np.outer(x[:, 2], np.eye(3)[2]), [(0, 1), (0, 2), (1, 2)]
        straight = [np.outer(x[:, i], np.eye(3)[i]) - along for i in (0, 1)]
        coupled = [x[:, [j]] * np.eye(3)[i] + x[:, [i]] * np.eye(3)[j] for i, j in across]
        return -np.stack([*straight, *coupled])


def of_cable(
    a: Float[np.ndarray, "*anchors 3"], x: Float[np.ndarray, "*#anchors samples 3"]
) -> tuple[Float[np.ndarray, "*anchors samples 3"], Float[np.ndarray, "*anchors samples 1"]]:
    """u and ℓ − ‖a‖ of a `Cable` from each point a."""
    along = a[..., None, :] - x
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    return along / length, length - np.linalg.norm(a, axis=-1)[..., None, None]


class Cable(PlatformSpring):
    """T, k, Δa: a taut cable from a fixed point a + Δa, relative to home; linear in Δa:

        F = f u,    f = T + k (ℓ − ‖a‖),    u = (a − x)/ℓ,    ℓ = ‖a − x‖
        ∂F/∂a = k u (u − a/‖a‖)ᵀ + f/ℓ (1 − u uᵀ)

    `orders` are a, and the T and k of these slopes.
    """

    name = "cable"
    symbols = ("T", "k", "ax", "ay", "az")
    units = ("N", "N/m", "m", "m", "m")
    text = "a taut cable pulls the platform to a fixed point"

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        a, (T, k) = np.array(self.orders[:3]), self.orders[3:]
        away, (u, longer) = np.linalg.norm(a), of_cable(a, x)
        turned = (T + k * longer) / (away + longer)
        slopes = [
            k * (u[:, [i]] - a[i] / away) * u + turned * (np.eye(3)[i] - u[:, [i]] * u)
            for i in range(3)
        ]
        return np.stack([u, longer * u, *slopes])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        (spring,) = super().to_corrections(judged[1:2])
        at_home = self.forces(np.zeros((1, 3)), np.zeros((1, 3)))[:, 0]
        return spring, self.pull(_values(judged) @ at_home, judged[:1])


class Drag(AtPlatform):
    """d, c: a force against the velocity, constant or in proportion to it."""

    kind = "platform-drag"
    name = "platform-drag"
    symbols = ("d", "c")
    units = ("N", "N s/m")

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        speed = np.hypot(np.linalg.norm(v, axis=1), RESTS * self.fastest)
        return -np.stack([v / speed[:, None], v])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        text = "something drags at the platform against its motion, as a hose or cable does"
        return (self.correction("platform", judged[0].value, judged[:1], "N", text),)


FORCES: tuple[type[AtPlatform], ...] = (ConstantForce, IsotropicSpring, AnisotropicSpring, Drag)
# Forces that are close to a cable's.
LIKE_CABLES = frozenset({ConstantForce.name, IsotropicSpring.name, AnisotropicSpring.name})


def platform_forces(dynamics: Dynamics, fastest: float) -> tuple[AtPlatform, ...]:
    """Each force with a prior of 1 in its units; a cable is searched for (`cable_search`)."""
    return tuple(
        force(dynamics, (), (1.0,) * len(force.symbols), fastest=fastest) for force in FORCES
    )
