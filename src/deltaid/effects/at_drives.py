"""Torques at single drives that a description lacks: springs and ripples.

With stiffness k_i and orders n,

    τ_i = Y_i p + k_i (q_i − q_0) + Σ_n (a_n sin n q_i + b_n cos n q_i).
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
from jaxtyping import Float

from deltaid.effects.along_motion import WITHOUT, AlongMotion, InTask, widest
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.robot.description import RobotDescription

AtDrive = Float[np.ndarray, " samples"]
Columns = Float[np.ndarray, "columns samples"]


class AtDrives(AlongMotion):
    """Torques that act on some drives, each along its own position."""

    @property
    def unit(self) -> str:
        """Unit of the coefficients."""
        return self.dynamics.robot.units(self.owners[0]).force

    @abstractmethod
    def of_drive(self, k: int, q: AtDrive, qd: AtDrive, qdd: AtDrive) -> Columns:
        """Columns of the k-th of these drives along its motion."""

    @property
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        named = zip(product(self.owners, self.symbols), self.deviation, strict=True)
        return [(owner, symbol, self.unit, size) for (owner, symbol), size in named]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(np.array(self.drives, dtype=int), len(self.symbols))
        return rows, np.arange(len(rows))

    def of_motion(self, z: InTask, qd: InTask, qdd: InTask) -> Values:
        motion = np.stack([self.dynamics.kinematics.inverse(z), qd, qdd])
        return np.vstack([self.of_drive(k, *motion[:, :, i]) for k, i in enumerate(self.drives)])


class DriveSpring(AtDrives):
    """k: a spring or balancer at each drive; k q_0 is a part of the friction law's offset."""

    kind = "drive-spring"
    name = "drive-spring"
    symbols = ("stiffness",)

    @property
    def unit(self) -> str:
        return self.dynamics.robot.units(self.owners[0]).stiffness

    def of_drive(self, k: int, q: AtDrive, qd: AtDrive, qdd: AtDrive) -> Columns:
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
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        numbers = np.repeat(self.orders, len(self.symbols))
        for row, order in zip(super().coefficients, numbers, strict=True):
            owner, symbol, unit, size = row
            yield owner, f"{symbol}{order:.4g}", unit, size

    def of_drive(self, k: int, q: AtDrive, qd: AtDrive, qdd: AtDrive) -> Columns:
        return np.stack([np.sin(self.orders[k] * q), np.cos(self.orders[k] * q)])

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        corrections, waves = list[Correction](), zip(judged[::2], judged[1::2], strict=True)
        for owner, order, (a, b) in zip(self.owners, self.orders, waves, strict=True):
            half = widest((a, b))
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
