"""All effects: a study searches `EFFECTS` in the residual, the contest fits `UNKNOWNS` together.

To delete an effect, delete its file and its lines here; the others keep working.
"""

from deltaid.effects.delay import Delay
from deltaid.effects.drift import Drift
from deltaid.effects.effect import Cause, Effect
from deltaid.effects.friction import (
    FrictionByDirection,
    FrictionByLoad,
    FrictionLaw,
    FrictionOverSpeed,
)
from deltaid.effects.gain import Gain
from deltaid.effects.gain_over_time import GainOverTime
from deltaid.effects.geometry import GearRatios, Lengths, Structure, Tilt, Zeros
from deltaid.effects.limbs import UnlikeLimbs
from deltaid.effects.load import LoadChange
from deltaid.effects.missing_friction import MissingFriction
from deltaid.effects.place import PlaceDependence
from deltaid.effects.point import UnknownEffect
from deltaid.effects.ripple import PositionRipple
from deltaid.effects.saturation import Saturation
from deltaid.effects.windings import WindUp
from deltaid.effects.zero import Zero

EFFECTS: tuple[Effect, ...] = (
    Delay(),
    Gain(),
    Saturation(),
    GainOverTime(),
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
    GainOverTime(),
    Zeros(),
    GearRatios(),
    Tilt(),
    Lengths(),
    Structure(),
    UnlikeLimbs(),
)


def effect_of(cause: Cause) -> Effect:
    return next(effect for effect in EFFECTS if effect.kind == cause.kind)
