"""Friction laws of a description: sums of terms, each linear in one coefficient.

With the joint's speed v and s = sign(v), the friction torque (a force in a sliding joint) is

    viscous·v + coulomb·s                        the paper's law, always present
    + viscous_back, coulomb_back                 replace viscous and coulomb for v < 0
    + offset                                     constant of either sign: a bias of the measurement
    + power·s·|v|^exponent                       lubricants: an exponent below 1 flattens with speed
    + stribeck·s·exp(−(|v|/speed)^exponent)      more friction near rest
    + hess_soom·s/(1 + (v/speed)²)               more friction near rest, by Hess and Soom
    + load·s·|x|                                 a gear's loss: a share of its load

where x is the drive's torque on the link's side of the gear, without friction and rotor inertia.
All coefficients but the offset are positive, so friction dissipates energy. To add a term, add a
key to `Friction` and a class to `friction_terms.py`.
"""

from typing import Annotated

from pydantic import Field, model_validator

from deltaid.robot.part import Part, Positive

# Range of exponents: below it, a power law is Coulomb friction; above it, an end stop.
EXPONENTS = (0.05, 5.0)
Exponent = Annotated[float, Field(ge=EXPONENTS[0], le=EXPONENTS[1])]


class PowerLaw(Part):
    """coefficient · sign(v) |v|^exponent."""

    coefficient: Positive = Field(description="N m (s/rad)^exponent, or N (s/m)^exponent")
    exponent: Exponent = Field(description="constant that is not identified with the rest")


class Stribeck(Part):
    """coefficient · sign(v) exp(−(|v|/speed)^exponent)."""

    coefficient: Positive = Field(
        description="how far friction at rest exceeds Coulomb's, N m or N"
    )
    speed: Positive = Field(description="speed at which it has fallen to 1/e, rad/s or m/s")
    exponent: Exponent = Field(default=1.0, description="1: Tustin's form, 2: Gauss's")


class HessSoom(Part):
    """coefficient · sign(v) / (1 + (v/speed)²), after Hess and Soom 1990."""

    coefficient: Positive = Field(
        description="how far friction at rest exceeds Coulomb's, N m or N"
    )
    speed: Positive = Field(description="speed at which it has fallen to a half, rad/s or m/s")


class Friction(Part):
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
    power: PowerLaw | None = Field(
        default=None, description="a term that grows slower, or faster, than speed"
    )
    stribeck: Stribeck | None = Field(default=None, description="more friction near rest")
    hess_soom: HessSoom | None = Field(
        default=None, description="more friction near rest, in the form of Hess and Soom"
    )
    load: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        default=None, description="share of what the gear carries that is lost; drives only"
    )

    @model_validator(mode="after")
    def _check(self) -> "Friction":
        if (self.viscous_back is None) != (self.coulomb_back is None):
            raise ValueError("give viscous_back and coulomb_back together")
        if self.coulomb_back is not None and self.offset is not None:
            raise ValueError(
                "offset says the same as coulomb_back; a law with both directions has none"
            )
        return self

    @property
    def plain(self) -> "Friction":
        """Law with viscous and Coulomb friction alone, as in the paper."""
        return Friction(viscous=self.viscous, coulomb=self.coulomb)

    @property
    def has_constant(self) -> bool:
        """Whether forward and backward friction may differ by a constant, such as an offset."""
        return self.offset is not None or not self.both_ways

    @property
    def both_ways(self) -> bool:
        """Whether both directions share their coefficients."""
        return self.coulomb_back is None
