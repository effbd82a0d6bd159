"""Spikes of torque channels: samples that stand out from those before and after."""

import numpy as np
from jaxtyping import Bool, Float

from deltaid.identification.expectation import Expectation

# A spike stands out by so many standard deviations of single samples, for so many at most; several
# drives at once have one only where it is over in less than this [s].
_SPIKE, _LONGEST, _AT_ONCE = 12.0, 3, 3e-3
# Samples on either side of a spike, whose range it exceeds so many times.
_BESIDE, _STEEP = 4, 3.0


def spikes(
    left: Float[np.ndarray, "dof samples"], expected: Expectation
) -> tuple[Bool[np.ndarray, "dof samples"], Float[np.ndarray, "dof samples"]]:
    """Single samples, or two or three, that stand out from both sides; and by how much [N m or N].

    Both edges must be far steeper than what goes before and after, or the top of a hump would do.
    """
    dof, samples = left.shape
    flags, jump = np.zeros((dof, samples), dtype=bool), np.zeros((dof, samples))
    limit = _SPIKE * expected.noise[:, None]
    far = _LONGEST + 1
    if samples <= 2 * far:
        return flags, jump
    apart = np.abs(left[:, far:] - left[:, :-far]) > limit
    if not np.any(apart[:, :-far] & apart[:, far:]):  # as nearly always
        return flags, jump
    brief = 1 if dof == 1 else _LONGEST
    for rows in range(1, _LONGEST + 1):
        reach = rows + 2 * _BESIDE
        if samples < reach:
            continue
        x = np.lib.stride_tricks.sliding_window_view(left, reach, axis=1)
        before, inside, after = x[..., :_BESIDE], x[..., _BESIDE:-_BESIDE], x[..., -_BESIDE:]
        up, down = inside - before[..., -1:], inside - after[..., :1]
        same = np.all(np.sign(up) == np.sign(up[..., :1]), axis=-1) & np.all(up * down > 0, axis=-1)
        size = np.where(same, np.minimum(np.abs(up), np.abs(down)).min(axis=-1), 0.0)
        beside = np.maximum(np.ptp(before, axis=-1), np.ptp(after, axis=-1))
        seen = (size > limit) & (size > _STEEP * beside)
        quiet = np.sum(size > 0.5 * limit, axis=0) == 1
        at_once = rows <= _AT_ONCE * expected.rate
        seen &= at_once | ((rows <= brief) & quiet)
        for i, k in np.argwhere(seen):
            here = slice(k + _BESIDE, k + _BESIDE + rows)
            flags[i, here], jump[i, here] = True, np.maximum(jump[i, here], size[i, k])
    return flags, jump
