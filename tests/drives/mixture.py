"""Three to five faults of random sizes in one recording."""

from dataclasses import dataclass

import numpy as np

from drives import drivetrain, measured, undescribed
from drives.made import Cause, Made
from plants import log_uniform

# Causes of mixtures: name, function, bounds of the size.
MIXED: dict[str, tuple[Cause, float, float]] = {
    "ripple": (measured.cogging, 0.005, 0.03),
    "delay": (measured.delay, 2e-4, 4e-3),
    "gain": (measured.gains, 0.005, 0.05),
    "offset": (measured.offsets, 0.002, 0.02),
    "zero": (measured.zeros, 0.05, 0.5),
    "gear-ratio": (measured.gear_ratio, 0.001, 0.01),
    "falling-gain": (measured.falling_gain, 0.015, 0.15),
    "stribeck": (drivetrain.stribeck, 0.05, 0.4),
    "direction": (drivetrain.direction, 0.01, 0.1),
    "bias": (drivetrain.bias, 0.01, 0.1),
    "load-friction": (drivetrain.load_friction, 0.005, 0.05),
    "warm-up": (drivetrain.warm_up, 0.03, 0.3),
    "play": (drivetrain.play, 0.005, 0.05),
    "compliance": (drivetrain.compliance, 5e3, 5e4),
    "length": (undescribed.lengths, 1e-4, 1e-3),
    "tilt": (undescribed.tilt, 0.1, 1.0),
    "hose": (undescribed.hose, 0.5, 5.0),
    "balancer": (undescribed.balancer, 0.01, 0.1),
}


@dataclass(frozen=True)
class Mixture:
    """A row of the second table with random faults."""

    words: str
    least: int = 3
    most: int = 5

    def make(self, made: Made, rng: np.random.Generator) -> Made:
        """Add random causes one after the other, each at most once."""
        names = rng.choice(list(MIXED), rng.integers(self.least, self.most + 1), replace=False)
        for name in names:
            cause, low, high = MIXED[str(name)]
            made = cause(made, rng, log_uniform(rng, low, high))
        return made
