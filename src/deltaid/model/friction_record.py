"""How friction laws were chosen: what a model file keeps of it."""

from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.robot.part import Part

AdditionKind = Literal["offset", "both_ways", "power", "stribeck", "load"]
# A joint, and the kind of term that its law gets.
JointTerm = tuple[str, str]


class FrictionTrial(Part):
    """One joint's law with one more term.

    Attributes:
        joint, addition: what was tried: 'offset', 'both_ways' (a law for each direction), 'power',
            'stribeck' or 'load'; of a term that is described, other constants.
        error: torque error that it leaves, as a share of the largest torque, root mean square over
            all drives.
        gain: by what share the squared error falls against the law before.
        significance: what it explains as a multiple of what chance explains, in amplitude. Of
            models before format 3 the mean gain over folds as a multiple of its standard error.
        useful: of a trial whether its gain is beyond chance; of a step whether the final law has
            it.
    """

    joint: str
    addition: AdditionKind
    error: float
    gain: float
    significance: float
    useful: bool


class FrictionChoice(Part):
    """The choice of friction laws.

    Attributes:
        folds: number of stretches of the recordings whose scatter says what chance explains.
        plain_error, chosen_error: torque error with the described and with the chosen laws, as in
            `FrictionTrial`.
        steps: what was added, in this order.
        trials: every addition alone, to the described laws.
    """

    folds: int
    plain_error: float
    chosen_error: float
    steps: tuple[FrictionTrial, ...]
    trials: tuple[FrictionTrial, ...]


class FrictionCurve(Part):
    """The friction of a joint over its speed, without what depends on load, with 95 % intervals.

    Attributes:
        joint: which.
        speed: ascending, both ways [rad/s or m/s].
        friction: at these speeds [N m or N].
        half_width: of its intervals, constants of the law counted as unknown.
    """

    joint: str
    speed: tuple[float, ...]
    friction: tuple[float, ...]
    half_width: tuple[float, ...]

    def band(self, speed: Float[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
        """Lower and upper ends of the intervals at speeds of the curve, between its points."""
        middle, half = (np.interp(speed, self.speed, x) for x in (self.friction, self.half_width))
        return np.stack([middle - half, middle + half])
