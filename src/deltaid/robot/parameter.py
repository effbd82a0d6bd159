"""Entries of the parameter vector p with unit, bounds and prior; units of joints."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

# Parameters that are fitted but do not belong to the robot.
AddedKind = Literal["load", "lag", "temperature", "gain", "constant", "effect", "sensor"]
ADDED: tuple[AddedKind, ...] = get_args(AddedKind)
ParameterKind = Literal["inertia", "friction", "spring", "rotor"] | AddedKind
_OF_BODIES = ("inertia", "load")

# Relative standard deviation of a prior by default.
PRIOR_SPREAD = 0.5


@dataclass(frozen=True)
class PriorParameter:
    """One parameter of a robot with its prior.

    Attributes:
        kind: such as 'inertia' or 'friction'.
        owner: name of its body or joint.
        symbol: its name there: 'mcx', 'Ixx', 'viscous', 'rotor'.
        unit: of its value.
        low, high: bounds; the value lies strictly between them.
        prior: its value in the description, after the reduction.
        scale: unit of deviations: |prior|, or a typical size if that is zero.
        spread: standard deviation of the prior as a share of `scale`.
    """

    kind: ParameterKind
    owner: str
    symbol: str
    unit: str
    low: float
    high: float
    prior: float
    scale: float
    spread: float = PRIOR_SPREAD

    @property
    def name(self) -> str:
        """'U.mcx' for an entry of a body, 'viscous.drive1' for a coefficient of a joint."""
        first, second = self.owner, self.symbol
        return f"{first}.{second}" if self.kind in _OF_BODIES else f"{second}.{first}"

    @property
    def label(self) -> str:
        """The name in formulas: 'mcx_U', 'viscous.drive1'."""
        return f"{self.symbol}_{self.owner}" if self.kind in _OF_BODIES else self.name

    @property
    def signed(self) -> bool:
        """Whether it may be negative."""
        return self.low < 0

    @property
    def std(self) -> float:
        """Standard deviation of the prior."""
        return self.spread * self.scale

    def margin(self, value: float) -> float:
        """Distance of a value from the nearest bound; negative beyond it."""
        return min(value - self.low, self.high - value)


@dataclass(frozen=True)
class JointUnits:
    """Words and units of a joint.

    Attributes:
        motion: 'angle' or 'position'.
        coordinate: unit of the joint's coordinate in files and arrays.
        shown: unit of the coordinate in figures.
        per_shown: factor from `coordinate` to `shown`.
        effort: 'torque' or 'force'.
        force: its unit.
        stiffness: unit of a spring.
        inertia: unit of a rotor inertia reduced to the joint.
    """

    motion: str
    coordinate: str
    shown: str
    per_shown: float
    effort: str
    force: str
    stiffness: str
    inertia: str

    @property
    def speed(self) -> str:
        """Unit of the joint's speed."""
        return f"{self.coordinate}/s"


TURNING = JointUnits(
    motion="angle",
    coordinate="rad",
    shown="deg",
    per_shown=float(np.rad2deg(1.0)),
    effort="torque",
    force="N m",
    stiffness="N m/rad",
    inertia="kg m²",
)
SLIDING = JointUnits(
    motion="position",
    coordinate="m",
    shown="m",
    per_shown=1.0,
    effort="force",
    force="N",
    stiffness="N/m",
    inertia="kg",
)
