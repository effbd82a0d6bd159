"""How friction laws were chosen: what a model file keeps of it."""

from typing import Literal

from deltaid.robot.part import Part

AdditionKind = Literal["offset", "both_ways", "power", "stribeck", "load"]


class FrictionTrial(Part):
    """One joint's law with one more term, judged by cross-validation.

    Attributes:
        joint, addition: what was tried: 'offset', 'both_ways' (a law for each direction), 'power',
            'stribeck' or 'load'.
        error: torque error on stretches that the fit has not seen, as a share of the largest
            torque, root mean square over all drives.
        gain: by what share the squared error falls against the law before.
        significance: the gain as a multiple of its standard error over the folds.
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
        folds: number of stretches of the recordings, each left out once.
        plain_error, chosen_error: cross-validated torque error with viscous and Coulomb friction
            only, and with the chosen laws, as in `FrictionTrial`.
        steps: what was added, in this order.
        trials: every addition alone, to viscous and Coulomb friction everywhere.
    """

    folds: int
    plain_error: float
    chosen_error: float
    steps: tuple[FrictionTrial, ...]
    trials: tuple[FrictionTrial, ...]
