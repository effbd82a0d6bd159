"""Friction laws of a joint as a user writes them: sums of terms, each linear in one coefficient.

With the joint's speed v and s = sign(v), the friction torque (a force in a sliding joint) is

    viscous·v + coulomb·s                        the law of the paper, always there
    + viscous_back, coulomb_back                 take their place for v < 0
    + offset                                     constant, of either sign: a bias of the measurement
    + power·s·|v|^exponent                       lubricants: exponent below 1 flattens with speed
    + stribeck·s·exp(−(|v|/speed)^exponent)      more friction near rest
    + load·s·|τ|                                 a gear's loss: a share of the drive's own torque τ

Every coefficient but the offset is positive, so friction always takes energy away.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from deltaid.robot.quantities import Positive

TermKind = Literal[
    "viscous", "coulomb", "viscous_back", "coulomb_back", "offset", "power", "stribeck", "load"
]
TERM_KINDS: tuple[TermKind, ...] = (
    "viscous", "coulomb", "viscous_back", "coulomb_back", "offset", "power", "stribeck", "load"
)  # fmt: skip

EXPONENTS = (0.05, 5.0)
Exponent = Annotated[float, Field(ge=EXPONENTS[0], le=EXPONENTS[1])]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PowerLaw(_Part):
    """coefficient · sign(v) |v|^exponent."""

    coefficient: Positive = Field(description="N m (s/rad)^exponent, or N (s/m)^exponent")
    exponent: Exponent = Field(description="constant that is not identified with the rest")


class Stribeck(_Part):
    """coefficient · sign(v) exp(−(|v|/speed)^exponent)."""

    coefficient: Positive = Field(
        description="how far friction at rest exceeds Coulomb's, N m or N"
    )
    speed: Positive = Field(description="speed at which it has fallen to 1/e, rad/s or m/s")
    exponent: Exponent = Field(default=1.0, description="1: Tustin's form, 2: Gauss's")


class Friction(_Part):
    """Prior friction of one joint; see the module's text for the law."""

    viscous: Positive = Field(description="N m s/rad, or N s/m in a sliding joint")
    coulomb: Positive = Field(description="N m, or N in a sliding joint")
    viscous_back: Positive | None = Field(
        default=None, description="viscous for negative speed; `viscous` then is for positive speed"
    )
    coulomb_back: Positive | None = Field(
        default=None, description="coulomb for negative speed; `coulomb` then is for positive speed"
    )
    offset: Positive | None = Field(
        default=None,
        description="typical size of a constant torque of either sign, whose prior is zero, N m "
        "or N",
    )
    power: PowerLaw | None = None
    stribeck: Stribeck | None = None
    load: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="share of the drive's own torque that is lost; drives only"
    )

    @model_validator(mode="after")
    def _check(self) -> "Friction":
        if (self.viscous_back is None) != (self.coulomb_back is None):
            raise ValueError("give viscous_back and coulomb_back together")
        if self.coulomb_back is not None and self.offset is not None:
            raise ValueError(
                "offset and coulomb_back say the same; a law with both directions has no offset"
            )
        return self

    @property
    def both_ways(self) -> bool:
        """Whether the same coefficients hold for both directions."""
        return self.coulomb_back is None

    @property
    def at_rest(self) -> float:
        """Largest friction near rest, without its load-dependent part [N m or N]."""
        more = self.stribeck.coefficient if self.stribeck else 0.0
        return max(self.coulomb, self.coulomb_back or 0.0) + more + (self.offset or 0.0)


@dataclass(frozen=True)
class FrictionTerm:
    """One term of one joint's law: one column of the regressor.

    Attributes:
        kind: which term.
        joint: of which joint.
        unit: of its coefficient.
        prior: of its coefficient; 0 for an offset.
        size: typical size of the coefficient: its prior, for an offset what the description says.
        one_sided: viscous and coulomb for positive speed only.
        exponent, speed: constants of the term, where it has them.
    """

    kind: TermKind
    joint: str
    unit: str
    prior: float
    size: float
    one_sided: bool = False
    exponent: float = 1.0
    speed: float = 1.0

    @property
    def name(self) -> str:
        """Name of the parameter, such as 'viscous.drive1'."""
        return f"{self.kind}.{self.joint}"

    @property
    def signed(self) -> bool:
        """Whether the coefficient may be negative."""
        return self.kind == "offset"


def friction_terms(joint: str, law: Friction, *, sliding: bool) -> tuple[FrictionTerm, ...]:
    """The terms of a joint's law in the order of `TERM_KINDS`."""
    force, per_speed = ("N", "s/m") if sliding else ("N m", "s/rad")
    viscous = "N s/m" if sliding else "N m s/rad"
    side = not law.both_ways

    def term(kind: TermKind, unit: str, size: float, **constants: float) -> FrictionTerm:
        prior = 0.0 if kind == "offset" else size
        one_sided = side and kind in ("viscous", "coulomb")
        return FrictionTerm(kind, joint, unit, prior, size, one_sided, **constants)

    terms = [term("viscous", viscous, law.viscous), term("coulomb", force, law.coulomb)]
    if law.viscous_back is not None and law.coulomb_back is not None:
        terms.append(term("viscous_back", viscous, law.viscous_back))
        terms.append(term("coulomb_back", force, law.coulomb_back))
    if law.offset is not None:
        terms.append(term("offset", force, law.offset))
    if law.power is not None:
        unit = f"{force} ({per_speed})^{law.power.exponent:.3g}"
        terms.append(term("power", unit, law.power.coefficient, exponent=law.power.exponent))
    if law.stribeck is not None:
        s = law.stribeck
        terms.append(term("stribeck", force, s.coefficient, exponent=s.exponent, speed=s.speed))
    if law.load is not None:
        terms.append(term("load", "1", law.load))
    return tuple(terms)
