"""The effects that a study searches; deleting one's file and its line leaves the others."""

from deltaid.effects.delay import Delay
from deltaid.effects.drift import Drift
from deltaid.effects.effect import Effect
from deltaid.effects.falling_gain import FallingGain
from deltaid.effects.friction import FrictionLaw
from deltaid.effects.gain import Gain
from deltaid.effects.load import LoadChange
from deltaid.effects.missing_friction import MissingFriction
from deltaid.effects.place import Place
from deltaid.effects.ripple import Ripple
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
