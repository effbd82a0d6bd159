"""Stamps that are none: far from those before and after them, which go on as if nothing were.

Damaged files have them, and loggers whose clock is read while it is set. Their rows stand between
their neighbours all the same.
"""

import numpy as np
from jaxtyping import Bool, Float

from deltaid.recording.time.grid import FAR, medians

# Rows about a stamp whose median it is compared with: up to half as many may be off in a row, and a
# staircase of gaps is its own median.
_ABOUT = 129

Times = Float[np.ndarray, " rows"]


def repaired(time: Times, period: float, sharing: float) -> tuple[Times, Bool[np.ndarray, " rows"]]:
    """Stamps with wild ones put where the rows about them say, and which these are.

    Args:
        time: stamps of consecutive rows [s].
        period: the usual time between two rows [s].
        sharing: rows that share a stamp.
    """
    far = FAR * sharing
    if len(time) < 3 or np.abs(np.diff(time)).max() <= far * period:
        return time, np.zeros(len(time), dtype=bool)
    rows = np.arange(len(time))
    level = time / period - rows
    usual = medians(level, _ABOUT)
    wild = np.abs(level - usual) > far
    return np.where(wild, period * (usual + rows), time), wild
