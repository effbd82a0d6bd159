"""Faults between motor and link: friction, gears; a size is a share where nothing else is said."""

from dataclasses import replace

import numpy as np

from drives.made import Made
from drives.rows import gear, lever, ways


def _law(made: Made, words: str, **changes: object) -> Made:
    return made.but(words, law=replace(made.happening.friction, **changes))


def stribeck(made: Made, rng: np.random.Generator, size: float) -> Made:
    """More friction below a knee of 3 to 10 % of the largest speed."""
    knee = float(rng.uniform(0.03, 0.1))
    return _law(made, f"Stribeck {size:.1%} below {knee:.1%} of the speed", stribeck=size,
                knee=knee * made.machine.largest_speed)  # fmt: skip


def direction(made: Made, rng: np.random.Generator, size: float) -> Made:
    """All friction is more in one direction."""
    of = size * ways(made.machine, rng)
    return _law(made, f"friction by direction {np.round(100 * of, 1).tolist()} %", direction=of)


def bias(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Coulomb friction is more in one direction, viscous friction is not."""
    of = size * ways(made.machine, rng)
    return _law(made, f"Coulomb friction by direction {np.round(100 * of, 1).tolist()} %", bias=of)


def load_friction(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A share of what the gear carries."""
    del rng
    return _law(made, f"friction of {size:.1%} of what the gear carries", load=size)


def warm_up(made: Made, rng: np.random.Generator, size: float) -> Made:
    """More friction at first, for 20 to 60 % of the recording."""
    constant = float(rng.uniform(0.2, 0.6)) * made.happening.duration
    return _law(made, f"warm-up {size:.1%} of {constant:.1f} s", warm=size, constant=constant)


def play(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Backlash (degrees), which changes its side with the sign of the torque or with its tanh."""
    hard = bool(rng.uniform() < 0.5)
    return made.but(f"play {size:.2g}°, {'hard' if hard else 'tanh'}", hard=hard,
                    backlash=np.deg2rad(size) * lever(made.machine))  # fmt: skip


def compliance(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Gears of a stiffness (N m/rad)."""
    del rng
    return made.but(f"gears of {size:.2g} N m/rad", stiffness=gear(made.machine, size))
