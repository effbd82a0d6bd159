"""Torques that a description lacks and that follow from the robot's motion alone.

At single drives these are springs and ripples,

    τ_i = Y_i p + k_i (q_i − q_0) + Σ_n (a_n sin n q_i + b_n cos n q_i).
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.estimation.additions import Addition, Own, Values, of_each, torques_of
from deltaid.model.corrections import Correction, FittedEffect, Kind
from deltaid.model.parameter_record import Parameter
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

WITHOUT = "the model is of the robot without it"

InTask = Float[np.ndarray, "samples dof"]
Position = Float[np.ndarray, " samples"]


@dataclass(frozen=True, eq=False)
class AlongMotion(Addition):
    """Torques of a robot that are linear in their coefficients."""

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

    @abstractmethod
    def record(self, values: tuple[float, ...]) -> FittedEffect:
        """The effect with its coefficients for a model file."""

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return tuple(
            PriorParameter("effect", owner, symbol, unit, -np.inf, np.inf, 0.0, size / PRIOR_SPREAD)
            for owner, symbol, unit, size in self.coefficients
        )

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return self.of_motion(w.z, w.qd)


@dataclass(frozen=True, eq=False)
class AtDrives(AlongMotion):
    """Columns of some drives' own torques."""

    drives: tuple[int, ...]  # which
    deviation: tuple[float, ...]  # prior standard deviation of each coefficient, drive by drive

    @property
    @abstractmethod
    def unit(self) -> str:
        """Unit of the coefficients."""

    @abstractmethod
    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        """Columns of the k-th of the drives by its position."""

    @property
    def owners(self) -> tuple[str, ...]:
        return tuple(self.dynamics.robot.drives[i] for i in self.drives)

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        named = [(owner, symbol) for owner in self.owners for symbol in self.symbols]
        pairs = zip(named, self.deviation, strict=True)
        return [(owner, symbol, self.unit, size) for (owner, symbol), size in pairs]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(np.array(self.drives, dtype=int), len(self.symbols))
        return rows, np.arange(len(rows))

    def of_motion(self, z: InTask, qd: InTask) -> Values:
        q = self.dynamics.kinematics.inverse(z)
        return np.vstack([self.of_drive(k, q[:, i]) for k, i in enumerate(self.drives)])

    def record(self, values: tuple[float, ...]) -> FittedEffect:
        return FittedEffect(name=self.name, values=values, drives=self.owners)


class DriveSpring(AtDrives):
    """k: a spring or balancer at each drive, about anywhere: friction's offset has the rest."""

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


def with_rests(robot: RobotDescription) -> RobotDescription:
    """With an offset in each friction law, which has the force of a drive's spring at q = 0."""
    laws = {
        joint: law.changed(offset=max(law.coulomb, np.finfo(float).tiny))
        for joint, law in robot.friction.items()
        if joint in robot.drives and law.both_ways and law.offset is None
    }
    return robot.changed(friction=dict(robot.friction) | laws)


@dataclass(frozen=True, eq=False)
class RippleColumns(AtDrives):
    """a, b: torques that repeat with a drive's position."""

    orders: tuple[float, ...] = ()  # n of each drive [1/rad or 1/m]

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

    def record(self, values: tuple[float, ...]) -> FittedEffect:
        return super().record(values).changed(orders=self.orders)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        corrections, waves = list[Correction](), zip(judged[::2], judged[1::2], strict=True)
        for owner, order, (a, b) in zip(self.owners, self.orders, waves, strict=True):
            half = max((x.high or x.value) - (x.low or x.value) for x in (a, b)) / 2
            size = float(np.hypot(a.value, b.value))
            text = (
                f"its torque ripples every {self._wave(owner, order)}, as teeth of a gear or "
                f"cogging do, and cables where that is as long as the stroke; {WITHOUT}"
            )
            corrections.append(
                Correction(kind=self.kind, subject=owner, value=size, low=max(size - half, 0.0),
                           high=size + half, unit=self.unit, text=text)
            )  # fmt: skip
        return tuple(corrections)

    def _wave(self, drive: str, order: float) -> str:
        """The length of a wave, as people say it."""
        length = 2 * np.pi / order
        linear = self.dynamics.robot.is_linear(drive)
        return f"{1e3 * length:.3g} mm" if linear else f"{np.degrees(length):.3g}°"


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
    """Those among the additions of a fit, by what it judged of all their parameters."""
    return tuple(
        FittedTorques(addition, tuple(entry.value for entry in own))
        for addition, own in of_each(tuple(additions), judged)
        if isinstance(addition, AlongMotion)
    )
