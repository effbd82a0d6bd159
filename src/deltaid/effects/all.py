"""All effects: those that a study searches, and those that the contest weighs.

Deleting one's class and its lines leaves the others.
"""

from deltaid.effects.drifting_gain import DriftingGain
from deltaid.effects.effect import Cause, Effect
from deltaid.effects.friction import (
    Drift,
    FrictionByDirection,
    FrictionByLoad,
    FrictionLaw,
    FrictionOverSpeed,
    MissingFriction,
)
from deltaid.effects.gain import Gain, Saturation
from deltaid.effects.geometry import GearRatios, Lengths, Structure, Tilt, Zero, Zeros
from deltaid.effects.lag_columns import Delay
from deltaid.effects.load import LoadChange
from deltaid.effects.point import UnknownEffect
from deltaid.effects.ripple import PlaceDependence, PositionRipple
from deltaid.effects.windings import WindUp

EFFECTS: tuple[Effect, ...] = (
    Delay(),
    Gain(),
    Saturation(),
    DriftingGain(),
    FrictionLaw(),
    Drift(),
    Zero(),
    PlaceDependence(),
    PositionRipple(),
    LoadChange(),
    MissingFriction(),
)

UNKNOWNS: tuple[UnknownEffect, ...] = (
    FrictionOverSpeed(),
    FrictionByDirection(),
    FrictionByLoad(),
    Drift(),
    Delay(),
    WindUp(),
    Gain(),
    Saturation(),
    DriftingGain(),
    Zeros(),
    GearRatios(),
    Tilt(),
    Lengths(),
    Structure(),
)


def effect_of(cause: Cause) -> Effect:
    return next(effect for effect in EFFECTS if effect.kind == cause.kind)
