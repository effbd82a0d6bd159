"""Torques at single drives that a description lacks: springs and ripples.

τ_i = Y_i p + k_i (q_i − q_0) + Σ_n (a_n sin n q_i + b_n cos n q_i)
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.effects.along_motion import AlongMotion, InTask
from deltaid.estimation.additions import Values
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.robot.description import RobotDescription
from deltaid.robot.parameter import PRIOR_SPREAD, Parameter

Position = Float[np.ndarray, " samples"]


@dataclass(frozen=True, eq=False)
class AtDrives(AlongMotion):
    """Columns of some drives' own torques.

    Attributes:
        drives: which.
        deviation: prior standard deviation of each coefficient, drive by drive.
    """

    drives: tuple[int, ...]
    deviation: tuple[float, ...]

    @property
    @abstractmethod
    def unit(self) -> str:
        """Of the coefficients."""

    @abstractmethod
    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        """Columns of the k-th of the drives by its position."""

    @property
    def owners(self) -> tuple[str, ...]:
        names = self.dynamics.robot.drives
        return tuple(names[i] for i in self.drives for _ in self.symbols)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        symbols = self.symbols * len(self.drives)
        return tuple(
            Parameter("effect", owner, symbol, self.unit, -np.inf, np.inf, 0.0, size / PRIOR_SPREAD)
            for owner, symbol, size in zip(self.owners, symbols, self.deviation, strict=True)
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.repeat(np.array(self.drives, dtype=int), len(self.symbols))
        return rows, np.arange(len(rows))

    def of_motion(self, z: InTask, qd: InTask) -> Values:
        q = self.dynamics.kinematics.inverse(z)
        return np.vstack([self.of_drive(k, q[:, i]) for k, i in enumerate(self.drives)])


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

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        return tuple(
            Correction(
                kind=self.kind, subject=owner, value=entry.value, low=entry.low, high=entry.high,
                unit=self.unit,
                text="a spring or balancer acts on the drive; the model is of the robot without it",
            )
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
    """a, b: torques that repeat with a drive's position.

    Attributes:
        orders: n of each drive [1/rad or 1/m].
    """

    orders: tuple[float, ...] = ()

    kind = "ripple"
    name = "ripple"
    symbols = ("sine", "cosine")

    @property
    def unit(self) -> str:
        return self.dynamics.robot.units(self.owners[0]).force

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        numbers = [f"{order:.4g}" for order in self.orders for _ in self.symbols]
        return tuple(
            replace(entry, symbol=f"{entry.symbol}{number}")
            for entry, number in zip(super().parameters, numbers, strict=True)
        )

    def of_drive(self, k: int, q: Position) -> Float[np.ndarray, "columns samples"]:
        return np.stack([np.sin(self.orders[k] * q), np.cos(self.orders[k] * q)])

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        corrections = list[Correction]()
        for k, order in enumerate(self.orders):
            a, b = judged[2 * k : 2 * k + 2]
            half = max((x.high or x.value) - (x.low or x.value) for x in (a, b)) / 2
            size = float(np.hypot(a.value, b.value))
            text = (
                f"its torque ripples {order:.3g} times a radian, as teeth of a gear or cogging do; "
                "the model is of the robot without it"
            )
            corrections.append(
                Correction(kind=self.kind, subject=self.owners[2 * k], value=size,
                           low=max(size - half, 0.0), high=size + half, unit=self.unit, text=text)
            )  # fmt: skip
        return tuple(corrections)
