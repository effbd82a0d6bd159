"""Which entries of a graph are more than rounding: what cancels by symmetry does so in numbers."""

import casadi as ca
import numpy as np
from jaxtyping import Int

from deltaid.mechanism.kinematics import Kinematics

# Generic states in which entries are looked at, and the share of the largest entry below which one
# is zero: rounding leaves 1e-15 of it.
_GENERIC, _ROUNDING = 64, 1e-12


def beyond_rounding(
    kinematics: Kinematics, inputs: ca.SX, entries: ca.SX
) -> Int[np.ndarray, " entries"]:
    """Which of some entries are not zero but for rounding, in generic states.

    Args:
        kinematics: of the robot.
        inputs: z and whatever else the entries are functions of.
        entries: a dense column.
    """
    robot, rng, dof = kinematics.robot, np.random.default_rng(0), kinematics.dof
    turn = 0.5 * (robot.turn.high - robot.turn.low)
    half = robot.within(0.0, turn)[1]
    z = kinematics.home + 0.5 * half * rng.uniform(-1, 1, (_GENERIC, dof))
    others = rng.standard_normal((_GENERIC, inputs.numel() - dof))
    values = ca.Function("entries", [inputs], [entries])(np.hstack([z, others]).T)
    largest = np.nanmax(np.abs(np.array(values)), axis=1, initial=0.0)  # NaN out of reach
    return np.flatnonzero(~(largest <= _ROUNDING * largest.max(initial=0.0)))
