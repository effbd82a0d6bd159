"""Torques that a description lacks and that follow from the robot's motion alone.

At single drives these are springs and ripples,

    τ_i = Y_i p + k_i (q_i − q_0) + Σ_n (a_n sin n q_i + b_n cos n q_i);

at the platform forces of a hose, a cable or a spring,

    F = f − K (x − x_0) − d v/|v| − c v,    τ = Y p − J_xᵀ F,    J_x = ∂x/∂q

with the place x of the platform, its velocity v, and its home x_0.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition, Own, Values, split_by_addition, torques_of
from deltaid.model.corrections import Correction, FittedEffect, Kind
from deltaid.model.parameter_record import Parameter
from deltaid.recording.masks.masks import RESTS
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

WITHOUT = "the model is of the robot without it"

InTask = Float[np.ndarray, "samples dof"]
Position = Float[np.ndarray, " samples"]
InWorld = Float[np.ndarray, "samples 3"]
Forces = Float[np.ndarray, "columns samples 3"]


@dataclass(frozen=True, eq=False)
class AlongMotion(Addition):
    """Torques of a robot that are linear in their coefficients."""

    drives: tuple[int, ...]  # that they act on; empty for a force at the platform
    deviation: tuple[float, ...]  # prior standard deviation of each coefficient, drive by drive
    orders: tuple[float, ...] = ()  # of ripples, n of each drive [1/rad or 1/m]
    fastest: float = 0.0  # largest speed of the platform [m/s]

    is_corrected = True
    kind: ClassVar[Kind]
    name: ClassVar[str]
    symbols: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        """Owner, symbol, unit and prior standard deviation of each; their means are zero."""

    @abstractmethod
    def of_motion(self, z: InTask, qd: InTask) -> Values:
        """Entries along a motion."""

    @property
    def owners(self) -> tuple[str, ...]:
        return tuple(self.dynamics.robot.drives[i] for i in self.drives)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return tuple(
            PriorParameter("effect", owner, symbol, unit, -np.inf, np.inf, 0.0, size / PRIOR_SPREAD)
            for owner, symbol, unit, size in self.coefficients
        )

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return self.of_motion(w.z, w.qd)

    def record(self, values: tuple[float, ...]) -> FittedEffect:
        return FittedEffect(name=self.name, values=values, drives=self.owners, orders=self.orders,
                            fastest=self.fastest)  # fmt: skip


class AtDrives(AlongMotion):
    """Torques that act on some drives, each along its own position."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the coefficients."""

    @abstractmethod
    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        """Columns of the k-th of these drives at its positions q."""

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        named = zip(product(self.owners, self.symbols), self.deviation, strict=True)
        return [(owner, symbol, self.unit, size) for (owner, symbol), size in named]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(np.array(self.drives, dtype=int), len(self.symbols))
        return rows, np.arange(len(rows))

    def of_motion(self, z: InTask, qd: InTask) -> Values:
        q = self.dynamics.kinematics.inverse(z)
        return np.vstack([self.of_drive(k, q[:, i]) for k, i in enumerate(self.drives)])


class DriveSpring(AtDrives):
    """k: a spring or balancer at each drive; k q_0 is a part of the friction law's offset."""

    kind = "drive-spring"
    name = "drive-spring"
    symbols = ("stiffness",)

    @property
    def unit(self) -> str:
        return self.dynamics.robot.units(self.owners[0]).stiffness

    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        return q[None]

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        text = f"a spring or balancer acts on the drive; {WITHOUT}"
        return tuple(
            Correction(kind=self.kind, subject=owner, value=entry.value, low=entry.low,
                       high=entry.high, unit=self.unit, text=text)
            for owner, entry in zip(self.owners, judged, strict=True)
        )  # fmt: skip


def with_offsets(robot: RobotDescription) -> RobotDescription:
    """Add an offset to each drive's friction law, for the torque of its spring at q = 0."""
    laws = {
        joint: law.changed(offset=max(law.coulomb, np.finfo(float).tiny))
        for joint, law in robot.friction.items()
        if joint in robot.drives and law.both_ways and law.offset is None
    }
    return robot.changed(friction=dict(robot.friction) | laws)


class RippleColumns(AtDrives):
    """a, b: torques that repeat with a drive's position."""

    kind = "ripple"
    name = "ripple"
    symbols = ("sine", "cosine")

    @property
    def unit(self) -> str:
        return self.dynamics.robot.units(self.owners[0]).force

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        numbers = np.repeat(self.orders, len(self.symbols))
        for row, order in zip(super().coefficients, numbers, strict=True):
            owner, symbol, unit, size = row
            yield owner, f"{symbol}{order:.4g}", unit, size

    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        return np.stack([np.sin(self.orders[k] * q), np.cos(self.orders[k] * q)])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        corrections, waves = list[Correction](), zip(judged[::2], judged[1::2], strict=True)
        for owner, order, (a, b) in zip(self.owners, self.orders, waves, strict=True):
            half = max((x.high or x.value) - (x.low or x.value) for x in (a, b)) / 2
            size, wave = float(np.hypot(a.value, b.value)), 2 * np.pi / order
            linear = self.dynamics.robot.is_linear(owner)
            length = f"{1e3 * wave:.3g} mm" if linear else f"{np.degrees(wave):.3g}°"
            text = (
                f"its torque ripples every {length}, as teeth of a gear or cogging do, and cables "
                f"where that is as long as the stroke; {WITHOUT}"
            )
            corrections.append(
                Correction(kind=self.kind, subject=owner, value=size, low=max(size - half, 0.0),
                           high=size + half, unit=self.unit, text=text)
            )  # fmt: skip
        return tuple(corrections)


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

    def of_motion(self, z: InTask, qd: InTask) -> Values:
        T, home = self.dynamics.kinematics.platform_jacobian(z), self.dynamics.kinematics.home
        x = self.dynamics.robot.task.point(z) - self.dynamics.robot.task.point(home)
        along = np.ascontiguousarray(T.transpose(1, 2, 0))
        forces = self.forces(x, np.sum(along * qd.T, axis=1).T).transpose(0, 2, 1)
        torques = sum(forces[:, None, i] * along[i] for i in range(3))
        return -np.reshape(torques, (-1, len(z)))

    def correction(
        self, value: float, judged: Sequence[Parameter], unit: str, text: str
    ) -> tuple[Correction, ...]:
        """A correction of this size, as wide as the widest interval of the coefficients."""
        ends = [(x.low, x.high) for x in judged if x.low is not None and x.high is not None]
        half = max((high - low) / 2 for low, high in ends)
        return (
            Correction(kind=self.kind, subject="platform", value=value, low=value - half,
                       high=value + half, unit=unit, text=f"{text}; {WITHOUT}"),
        )  # fmt: skip

    def pull(self, judged: Sequence[Parameter], what: str) -> tuple[Correction, ...]:
        """A correction by a force at home with these components."""
        f = np.array([entry.value for entry in judged])
        way = ", ".join(f"{share:.2f}" for share in f / max(np.linalg.norm(f), 1e-300))
        text = f"{what} pulls at the platform along ({way}), as a hose or cable does"
        return self.correction(float(np.linalg.norm(f)), judged, "N", text)


class ConstantForce(AtPlatform):
    """f: a force that is the same everywhere."""

    name = "platform-force"
    symbols = ("Fx", "Fy", "Fz")
    units = ("N",) * 3

    def forces(self, x: InWorld, v: InWorld) -> Forces:
        return np.eye(3)[:, None, :] * np.ones((len(x), 1))

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        return self.pull(judged, "a constant force")


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
        stiff = self.correction(stiffness, judged[:6], "N/m", text)
        return (*stiff, *self.pull(judged[6:], "where the robot is at home, this spring"))


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
        return self.correction(judged[0].value, judged[:1], "N", text)


@dataclass(frozen=True, eq=False)
class FittedTorques:
    """An effect with its coefficients; a `recording.repairs.Pull`."""

    addition: AlongMotion
    values: tuple[float, ...]

    def torques(self, z: InTask, qd: InTask) -> InTask:
        entries = self.addition.of_motion(z, qd)
        return torques_of(self.addition.pattern, qd.shape[1], entries, np.array(self.values)).T


def fitted_effects(
    additions: Iterable[Addition], judged: Sequence[Parameter]
) -> tuple[FittedTorques, ...]:
    """Effects among the additions of a fit, with the values of its judged parameters."""
    return tuple(
        FittedTorques(addition, tuple(entry.value for entry in parameters))
        for addition, parameters in split_by_addition(tuple(additions), judged)
        if isinstance(addition, AlongMotion)
    )


FORCES: tuple[type[AtPlatform], ...] = (ConstantForce, PlatformSpring, Drag)


def platform_forces(dynamics: Dynamics, fastest: float) -> tuple[AtPlatform, ...]:
    """Each force with a prior of 1 in its units."""
    return tuple(
        force(dynamics, (), (1.0,) * len(force.symbols), fastest=fastest) for force in FORCES
    )


def as_fitted(dynamics: Dynamics, record: FittedEffect) -> FittedTorques:
    drives = tuple(dynamics.robot.drives.index(drive) for drive in record.drives)
    effects: tuple[type[AlongMotion], ...] = (RippleColumns, DriveSpring, *FORCES)
    effect = next(effect for effect in effects if effect.name == record.name)
    deviation = (1.0,) * len(record.values)
    addition = effect(dynamics, drives, deviation, record.orders, record.fastest)
    return FittedTorques(addition, record.values)
