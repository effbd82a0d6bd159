"""What a sensor plan assumes."""

from dataclasses import dataclass

from deltaid.robot.parameter import PRIOR_SPREAD


@dataclass(frozen=True)
class PlanSettings:
    """What a plan assumes.

    Attributes:
        torque_noise: standard deviation of the torques' noise, as a share of each drive's largest
            torque along the motion.
        rate: independent samples a second, of torques and of sensors.
        duration: of the generic motion [s].
        prior_spread: relative standard deviation of the prior, where the description has no other.
        gain_spread: of the drives' torque constants; None for 0.1 if these are the goal, and for
            drives that are right else.
        enough: share of an entry, or of the largest force, that is good enough: to know it better
            is no gain.
        steps: how many things are bought at most.
        seed: of the generic motion.
    """

    torque_noise: float = 0.02
    rate: float = 200.0
    duration: float = 20.0
    prior_spread: float = PRIOR_SPREAD
    gain_spread: float | None = None
    enough: float = 0.01
    steps: int = 10
    seed: int = 0
