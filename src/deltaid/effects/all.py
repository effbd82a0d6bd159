"""All effects: those that a study searches, and those that the contest weighs.

Deleting one's file and its lines leaves the others.
"""

from deltaid.effects.delay import Delay
from deltaid.effects.drift import Drift
from deltaid.effects.effect import Cause, Effect
from deltaid.effects.falling_gain import FallingGain, Saturation
from deltaid.effects.friction import FrictionLaw
from deltaid.effects.gain import Gain, GainRatios
from deltaid.effects.geometry import GearRatios, Lengths, Structure, Tilt, Zeros
from deltaid.effects.load import LoadChange
from deltaid.effects.missing_friction import MissingFriction
from deltaid.effects.place import PlaceDependence
from deltaid.effects.ripple import PositionRipple
from deltaid.effects.unknown import BESIDE, UnknownEffect
from deltaid.effects.zero import Zero

EFFECTS: tuple[Effect, ...] = (
    Delay(),
    Gain(),
    FallingGain(),
    FrictionLaw(),
    Drift(),
    Zero(),
    PlaceDependence(),
    PositionRipple(),
    LoadChange(),
    MissingFriction(),
)

UNKNOWNS: tuple[UnknownEffect, ...] = (
    *BESIDE,
    GainRatios(),
    Saturation(),
    Zeros(),
    GearRatios(),
    Tilt(),
    Lengths(),
    Structure(),
)


def effect_of(cause: Cause) -> Effect:
    """The effect that a cause was detected by."""
    return next(effect for effect in EFFECTS if effect.kind == cause.kind)
