"""How noisy speeds are, from speeds alone.

A motion is smooth, noise is not: noise makes nearly all of the n-th difference Dₙ of a drive's
speeds. Where measured numbers have white noise, and speeds are sums of these with weights c,

    σ² = Σ c² / Σ (c ∗ d)² · E Dₙ²,   d the weights of the n-th difference.

A motion makes σ larger than it is; a push does not, as bodies move smoothly then too. The mean is
over cycles in which the drive moves: at rest, steps of an encoder are still.
"""

import casadi as ca
import numpy as np

from deltaid.online.graph import CycleFields, Field
from deltaid.online.instant import Waits
from deltaid.online.settings import OnlineSettings
from deltaid.online.signals import Signals

# Differences of speeds, and how long what they show is remembered, of motion [s].
_ORDER, _MEMORY = 5, 10.0
# The most that one cycle counts, in units of the variance so far: rows that were skipped leave
# more for some cycles.
_LARGEST_STEP = 10.0


def learn_speed_noise(
    fields: CycleFields, s: Signals, wait: Waits, settings: OnlineSettings
) -> ca.SX:
    """Variance of each drive's speed, as known before this cycle.

    It begins with `rest_speed`, below which the sign of a speed is not known, as one cycle's.
    """
    dof = s.qd.numel()
    variance, cycles, *past = fields.keep(
        Field("speed_variance", dof, "of speeds", initial=settings.rest_speed**2),
        Field("speed_cycles", dof, "in which they were measured", initial=1.0),
        *(Field(f"speed_{k}", dof, f"difference {k} of speeds") for k in range(_ORDER)),
    )
    differences = [s.qd]
    for before in past:
        differences.append(differences[-1] - before)
    shown = share_of_noise(wait, settings) * differences[-1] ** 2
    moves = ca.logic_and(s.slow < 0.5, ca.logic_and(s.settled, s.calm))
    step = ca.fmin(shown, _LARGEST_STEP * variance) - variance
    count = ca.fmin(cycles + moves, _MEMORY / settings.period)
    fields.following |= {"speed_variance": variance + moves * step / count, "speed_cycles": count}
    fields.following |= {f"speed_{k}": x for k, x in enumerate(differences[:-1])}
    return variance


def share_of_noise(wait: Waits, settings: OnlineSettings) -> float:
    """Σ c² / Σ (c ∗ d)²: variance of speeds for that of their n-th difference."""
    share = wait.motion % 1.0
    c = np.array([1 - share, share])
    if settings.speed == "differenced":
        c = np.convolve(c, [1.0, -1.0])
    d = c
    for _ in range(_ORDER):
        d = np.convolve(d, [1.0, -1.0])
    return float(np.sum(c**2) / np.sum(d**2))
