"""What is asked of an excitation; imports nothing that is slow."""

import math
from dataclasses import dataclass
from numbers import Integral
from typing import Literal, get_args

from deltaid.errors import DeltaidError, positive, typed, unknown, within
from deltaid.levels import TORQUE_NOISE
from deltaid.robot.parameter import PRIOR_SPREAD

CriterionName = Literal["logdet", "cond", "a-optimal", "e-optimal"]
PurposeName = Literal["torques", "sensors"]

# Start values of a verification motion: as many seeds on as anybody will ask starts for.
VERIFICATION_OFFSET = 100_000
_HERE = "ExcitationSettings"


@dataclass(frozen=True)
class ExcitationSettings:
    """What to optimise.

    Attributes:
        criterion: of the information matrix.
        harmonics: n_F of (8).
        duration: longest period [s]; the optimiser may shorten the period to a quarter, and then
            so many whole periods are run that they last about as long.
        repeats: how often all of that is run, for averaging.
        velocity_weight: w of (9), which asks for speed so that friction shows.
        weigh_prior: excite what is uncertain by the prior, in units of the torque noise.
        prior_spread: relative standard deviation of the prior, for that and for the verdict.
        torque_noise: standard deviation of the torque noise, as a share of each drive's largest
            torque on random motions.
        rate: sampling rate of the recording [Hz].
        starts, seed: how many starts, and the first one's seed.
        by: what decides between the motions of all starts: the criterion, of torques, or what
            `sensors` and measured values of the description tell of all bodies besides.

    Raises:
        DeltaidError: there is no such criterion or purpose, or a number is none of its kind.
    """

    criterion: CriterionName = "logdet"
    harmonics: int = 5
    duration: float = 10.0
    repeats: int = 1
    velocity_weight: float = 0.1
    weigh_prior: bool = False
    prior_spread: float = PRIOR_SPREAD
    torque_noise: float = TORQUE_NOISE
    rate: float = 1000.0
    starts: int = 8
    seed: int = 0
    by: PurposeName = "torques"

    def __post_init__(self) -> None:
        for name, value, known in (
            ("criterion", self.criterion, get_args(CriterionName)),
            ("purpose", self.by, get_args(PurposeName)),
        ):
            if value not in known:
                raise unknown(value, known, name, _HERE)
        for name in ("harmonics", "repeats", "starts", "seed"):
            value = getattr(self, name)
            typed(f"{_HERE}.{name}", value, Integral, "a whole number")
            if value < 1 and name != "seed":
                raise DeltaidError(f"{name} is {value:g}", where=_HERE, cure="at least 1")
        for name in ("duration", "torque_noise", "rate", "prior_spread"):
            positive(f"{_HERE}.{name}", getattr(self, name))
        within(f"{_HERE}.velocity_weight", self.velocity_weight, (0.0, math.inf))
