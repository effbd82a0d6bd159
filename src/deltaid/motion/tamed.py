"""A motion made smaller and slower until a robot can run it: every limit kept, with a margin."""

from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.limits import LimitsAlong
from deltaid.errors import KinematicsError
from deltaid.motion.fourier import FourierMotion

# Share of a torque limit that may be used: noise and a controller's feedback come on top.
_EFFORT = 0.8
_GRID, _STEPS = 1000, 60
# How much slower each step, and how much smaller the tool's turns.
_LESS = 0.93


def tamed(dynamics: Dynamics, p: Parameters, motion: FourierMotion) -> FourierMotion:
    """The motion, its tool's turns made smaller if only these are too fast, and then slower.

    Slowing leaves the path as it is; turns are made smaller first, because a fourth drive that is
    short of torque would slow the whole robot down.

    Raises:
        KinematicsError: the path leaves the workspace, or standing on it takes too much torque.
    """
    limits = LimitsAlong(dynamics)
    turn = dynamics.robot.task.turn
    if turn is not None and not _kept(limits, p, motion):
        still = _turning(motion, turn, 0.0)
        if _kept(limits, p, still):
            ladder = (_turning(motion, turn, _LESS**k) for k in range(1, _STEPS))
            return next((m for m in ladder if _kept(limits, p, m)), still)
    paces = (_LESS**k for k in range(_STEPS))
    slower = (replace(motion, base_frequency=motion.base_frequency * pace) for pace in paces)
    found = next((m for m in slower if _kept(limits, p, m)), None)
    if found is None:
        use = _use(limits, p, replace(motion, base_frequency=motion.base_frequency * _LESS**_STEPS))
        worst = max(use, key=lambda name: use[name])
        raise KinematicsError(
            f"no motion keeps the described limits: {worst} is at {use[worst]:.0%} of what may be "
            "used of it, however slow the motion is",
            where=dynamics.robot.name,
            cure="check workspace, drive_limits and masses in the description",
        )
    return found


def _turning(motion: FourierMotion, turn: int, factor: float) -> FourierMotion:
    """The same motion with turns of the tool that are `factor` times as large."""
    scale = np.ones((len(motion.centre), 1))
    scale[turn] = factor
    return replace(motion, sine=motion.sine * scale, cosine=motion.cosine * scale)


def _kept(limits: LimitsAlong, p: Parameters, motion: FourierMotion) -> bool:
    return max(_use(limits, p, motion).values(), default=0.0) <= 1.0


def _use(limits: LimitsAlong, p: Parameters, motion: FourierMotion) -> dict[str, float]:
    """Largest use of each limit, 1 where its share is used up."""
    phases = np.linspace(0.0, 2 * np.pi, _GRID)
    z, zd, zdd = motion.evaluate(phases / motion.base_frequency)
    kinematic = limits.kinematic(z, zd, zdd).max(axis=0)
    efforts = limits.effort(z, zd, zdd, p).max(axis=0) / _EFFORT
    names = (*limits.names, *limits.efforts)
    return dict(zip(names, map(float, (*kinematic, *efforts)), strict=True))
