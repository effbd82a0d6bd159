"""Parameters of p with unit, bounds and prior; units of joints. Imports nothing that is slow."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

# Parameters that are fitted but do not belong to the robot.
AddedKind = Literal["load", "lag", "temperature", "gain", "constant", "effect", "sensor"]
ADDED: tuple[AddedKind, ...] = get_args(AddedKind)
ParameterKind = Literal["inertia", "friction", "spring", "rotor"] | AddedKind
_OF_BODIES = ("inertia", "load")

# Default standard deviation of a prior, as a share of its value.
PRIOR_SPREAD = 0.5


@dataclass(frozen=True)
class PriorParameter:
    """One parameter of a robot with its prior.

    Attributes:
        kind: group of parameters, such as 'inertia' or 'friction'.
        owner: name of the body or joint.
        symbol: name of the parameter there, such as 'mcx', 'Ixx', 'viscous' or 'rotor'.
        unit: unit of the value.
        low, high: bounds; the value lies strictly between them.
        prior: value in the description, after the reduction.
        scale: |prior|, or a typical size if that is zero, in this unit.
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
        """Name: 'U.mcx' for an entry of a body, 'viscous.drive1' for a coefficient of a joint."""
        first, second = self.owner, self.symbol
        return f"{first}.{second}" if self.kind in _OF_BODIES else f"{second}.{first}"

    @property
    def label(self) -> str:
        """Name in formulas, such as 'mcx_U' or 'viscous.drive1'."""
        return f"{self.symbol}_{self.owner}" if self.kind in _OF_BODIES else self.name

    @property
    def signed(self) -> bool:
        """Whether the value may be negative."""
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
        motion: word for the coordinate, 'angle' or 'position'.
        coordinate: unit of the coordinate in files and arrays.
        shown: unit of the coordinate in figures.
        per_shown: factor from `coordinate` to `shown`.
        effort: word for what acts on the joint, 'torque' or 'force'.
        force: unit of this torque or force.
        stiffness: unit of a spring's stiffness.
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
    per_shown=math.degrees(1.0),
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
