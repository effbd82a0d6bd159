"""All effects: those that a study searches, and those that the contest weighs.

Deleting one's file and its lines leaves the others.
"""

from deltaid.effects.delay import Delay
from deltaid.effects.drift import Drift
from deltaid.effects.effect import Cause, Effect
from deltaid.effects.falling_gain import FallingGain, Saturation
from deltaid.effects.friction import FrictionLaw
from deltaid.effects.gain import Gain
from deltaid.effects.gain import Ratios as Gains
from deltaid.effects.geometry import Lengths, Ratios, Structure, Tilt, Zeros
from deltaid.effects.load import LoadChange
from deltaid.effects.missing_friction import MissingFriction
from deltaid.effects.place import Place
from deltaid.effects.ripple import Ripple
from deltaid.effects.unknown import BESIDE, Unknown
from deltaid.effects.zero import Zero

EFFECTS: tuple[Effect, ...] = (
    Delay(),
    Gain(),
    FallingGain(),
    FrictionLaw(),
    Drift(),
    Zero(),
    Place(),
    Ripple(),
    LoadChange(),
    MissingFriction(),
)

UNKNOWNS: tuple[Unknown, ...] = (
    *BESIDE,
    Gains(),
    Saturation(),
    Zeros(),
    Ratios(),
    Tilt(),
    Lengths(),
    Structure(),
)


def effect_of(cause: Cause) -> Effect:
    """The effect that a cause was detected by."""
    return next(effect for effect in EFFECTS if effect.kind == cause.kind)
