"""What stands out again and again for a reason in a drive: friction and play.

Friction that the description has no law for stands out where a joint turns round, play where the
torque that a gear carries changes its sign.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from deltaid.identification.outstanding import Outstanding, Stretch
from deltaid.recording.filter import LowPass

# A stretch belongs to a change of sign within so much time [s] and this share of the low-pass's
# period; so many must for a drive, this share of its stretches, by chance this unlikely.
_NEAR, _PERIOD, _FEWEST, _OFTEN, _CHANCE = 6e-3, 0.6, 8, 0.5, 1e-6
# One that is so many times as large as those of play usually are is more than play.
_LARGER = 4.0


def of_drives(
    seen: Outstanding, stretches: Sequence[Stretch], low_pass: LowPass | None
) -> tuple[Bool[np.ndarray, " stretches"], Bool[np.ndarray, " stretches"]]:
    """Which stretches are friction at reversals, and which play in gears where torques reverse."""
    near = _NEAR + (_PERIOD / low_pass.motion_cutoff if low_pass else 0.0)
    peaks = np.array([one.peak for one in stretches])
    first = np.array([int(np.argmax(np.abs(one.sizes))) for one in stretches], dtype=int)
    size = np.array([one.size for one in stretches])
    nothing = np.zeros(len(stretches), dtype=bool)
    friction, play = nothing.copy(), nothing.copy()
    for j, times in enumerate(seen.reversals):
        own = first == j if j < len(seen.turns) else ~nothing
        if _recurs(peaks[own], times, near, seen.looked):
            friction |= own & _beside(peaks, times, near)
    loose = nothing.copy()
    for i, times in enumerate(seen.turns):
        own = (first == i) & ~friction
        if _recurs(peaks[own], times, near, seen.looked):
            loose |= own & _beside(peaks, times, near)
            play |= ~friction & _beside(peaks, times, near)
    if play.any():
        # Drives share what play in one of them makes of the positions.
        play = ~friction & (size <= _LARGER * np.median(size[loose]))
    return friction, play


def _beside(
    peaks: Float[np.ndarray, " _"], times: Float[np.ndarray, " _"], near: float
) -> Bool[np.ndarray, " _"]:
    """Which peaks are near one of some times."""
    if not len(times):
        return np.zeros(len(peaks), dtype=bool)
    after = np.clip(np.searchsorted(times, peaks), 1, max(1, len(times) - 1))
    sides = np.stack([times[after - 1], times[np.minimum(after, len(times) - 1)]])
    return np.min(np.abs(sides - peaks), axis=0) <= near


def _recurs(
    peaks: Float[np.ndarray, " _"], times: Float[np.ndarray, " _"], near: float, duration: float
) -> bool:
    """Whether stretches are near some times more often than chance has it."""
    if len(peaks) < _FEWEST or not len(times):
        return False
    gaps = np.minimum(np.diff(times), 2 * near)
    share = min(1.0, (gaps.sum() + 2 * near) / duration)
    hits = int(_beside(peaks, times, near).sum())
    unlikely = bdtrc(hits - 1, len(peaks), share) < _CHANCE  # of so many or more
    return hits >= max(_FEWEST, _OFTEN * len(peaks)) and bool(unlikely)
