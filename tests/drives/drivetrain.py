"""Faults between motor and link: friction and gears. A size without a unit is a share."""

from dataclasses import replace

import numpy as np

from drives.made import Made
from drives.rows import gear, lever, ways


def _law(made: Made, words: str, **changes: object) -> Made:
    return made.but(words, law=replace(made.happening.friction, **changes))


def stribeck(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Higher friction below 3 to 10 % of the largest speed."""
    knee = float(rng.uniform(0.03, 0.1))
    return _law(made, f"Stribeck {size:.1%} below {knee:.1%} of the speed", stribeck=size,
                knee=knee * made.machine.largest_speed)  # fmt: skip


def direction(made: Made, rng: np.random.Generator, size: float) -> Made:
    """All friction is higher in one direction."""
    of = size * ways(made.machine, rng)
    return _law(made, f"friction by direction {np.round(100 * of, 1).tolist()} %", direction=of)


def bias(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Coulomb friction is higher in one direction; viscous friction is symmetric."""
    of = size * ways(made.machine, rng)
    return _law(made, f"Coulomb friction by direction {np.round(100 * of, 1).tolist()} %", bias=of)


def load_friction(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Friction that is a share of the torque that the gear carries."""
    del rng
    return _law(made, f"friction of {size:.1%} of what the gear carries", load=size)


def warm_up(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Higher friction at first, with a time constant of 20 to 60 % of the recording."""
    constant = float(rng.uniform(0.2, 0.6)) * made.happening.duration
    return _law(made, f"warm-up {size:.1%} of {constant:.1f} s", warm=size, constant=constant)


def presliding(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Friction that yields over a share of the stroke before it slips."""
    del rng
    path = made.machine.plant.oracle.positions(made.machine.plant.path[::8])
    return _law(made, f"friction yields over {size:.2%} of the stroke",
                distance=size * np.ptp(path, axis=0))  # fmt: skip


def play(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Backlash (degrees) that changes sides with the sign of the torque, or with its tanh."""
    hard = bool(rng.uniform() < 0.5)
    return made.but(f"play {size:.2g}°, {'hard' if hard else 'tanh'}", hard=hard,
                    backlash=np.deg2rad(size) * lever(made.machine))  # fmt: skip


def compliance(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Gears with a stiffness (N m/rad)."""
    del rng
    return made.but(f"gears of {size:.2g} N m/rad", stiffness=gear(made.machine, size))
