"""Faults in the measurement of torques and angles. A size without a unit is a share."""

import numpy as np

from drives.made import Made
from drives.robots import Machine
from drives.rows import lever, ways
from oracle.tree import Array
from plants import log_uniform


def _span(m: Machine) -> Array:
    """1 for a rotary drive; for a linear one, the metres that correspond to a radian."""
    return np.where(m.rotary, 1.0, lever(m))


def ripple(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Torque ripple with 12 waves per turn, or over the corresponding length of a linear drive."""
    m = made.machine
    return made.on(
        f"ripple {size:.1%}, 12 waves a turn", ripple=size,
        waves=12 / _span(m), phase=rng.uniform(0, 2 * np.pi, m.dof),
    )  # fmt: skip


def zeros(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Normal errors of homing with this standard deviation (degrees)."""
    m = made.machine
    homing = np.deg2rad(size) * lever(m) * rng.standard_normal(m.dof)
    homing[len(m.plant.oracle.limbs) :] = 0.0
    return made.on(f"zeros {size:.2g}°", homing=homing)


def gear_ratio(made: Made, rng: np.random.Generator, size: float) -> Made:
    """The recorded angle of one drive of a limb is too large by a share; torques are right.

    A telescope's drive is excluded: there a wrong ratio equals another moment of inertia.
    """
    m = made.machine
    drive = int(rng.integers(len(m.plant.oracle.limbs)))
    scale = np.ones(m.dof)
    scale[drive] += size
    return made.on(f"gear ratio of {m.robot.drives[drive]} {size:.2%} off", scale=scale)


def falling_gain(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Torque constants that fall with current, by a share at the largest torque of the motion.

    For a recorded torque r the true one is r (1 − size (r / largest r)²).
    """
    del rng

    def believed(true: Array) -> Array:
        # At the largest torque r is 1 / (1 − size). With x = r / largest r, size x³ − x + y = 0 is
        # solved by x = A sin θ, A² = 4 / (3 size), sin 3θ = 3 y / A.
        y, A = (1 - size) * true, np.sqrt(4 / (3 * size))
        return A * np.sin(np.arcsin(3 * y / A) / 3) / (1 - size)

    return made.on(f"torque constants −{size:.1%} at full current", believed=believed)


def saturation(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Motors that saturate: true is s tanh(r / s), with s a share of the largest recorded r."""
    del rng
    limit = 1 / np.tanh(1 / size)  # s over the largest true torque
    return made.on(
        f"torques saturate at {size:.0%}", believed=lambda true: limit * np.arctanh(true / limit)
    )


def cogging(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Ripple of 5 to 60 waves per turn, not a whole number, the same in all drives of limbs."""
    m = made.machine
    orders = np.full(m.dof, log_uniform(rng, 5, 60))
    orders[len(m.plant.oracle.limbs) :] = log_uniform(rng, 5, 60)
    return made.on(
        f"ripple {size:.2%}, {orders[0]:.1f} waves a turn",
        ripple=size * rng.uniform(0.5, 1, m.dof), waves=orders / _span(m),
        phase=rng.uniform(0, 2 * np.pi, m.dof),
    )  # fmt: skip


def delay(made: Made, rng: np.random.Generator, size: float) -> Made:
    """A lag or lead of torques (s): the same in all drives, or up to this size in each."""
    each = bool(rng.uniform() < 0.5)
    dof = made.machine.dof
    share = rng.uniform(-1, 1, dof) if each else np.full(dof, rng.choice([-1.0, 1.0]))
    late = size * share / np.abs(share).max()
    return made.on(f"delays {np.round(1e3 * late, 2).tolist()} ms", delay=late)


def gains(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Errors of the torque constants of the limbs' drives, with a geometric mean of 1.

    A common factor of all constants is the scale of the whole model, which is not identifiable
    without a known load; the constant of a telescope's drive hardly is.
    """
    m = made.machine
    count = len(m.plant.oracle.limbs)
    log = rng.uniform(-1, 1, count)
    log -= log.mean()
    gain = np.ones(m.dof)
    gain[:count] = (1 + size) ** (log / np.abs(log).max())
    return made.on(f"gains {np.round(gain, 4).tolist()}", gain=gain)


def offsets(made: Made, rng: np.random.Generator, size: float) -> Made:
    """Offsets of torque columns; their mean is zero with linear drives, see `ways`."""
    m = made.machine
    if np.all(m.rotary):
        offset = size * rng.choice([-1.0, 1.0], m.dof) * rng.uniform(0.5, 1, m.dof)
    else:
        newtons = ways(m, rng) * m.coulomb
        share = newtons / m.largest_torque
        offset = size * share / np.abs(share).max()
    return made.on(f"offsets {np.round(100 * offset, 2).tolist()} %", offset=offset)
