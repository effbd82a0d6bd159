"""Outliers that recur for a reason in a drive: friction and play.

Friction that the description has no law for causes outliers where a joint turns round, play where
the torque that a gear carries changes its sign. There a motor runs ahead through its play, and all
drives' torques follow from another motion, whether they are outliers or not.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from deltaid.identification.outstanding import Outstanding, Stretch
from deltaid.recording.filter import LowPass
from deltaid.recording.repairs import BACKLASH, LeftSpan

# A stretch belongs to a change of sign within so much time [s] and this share of the low-pass's
# period; so many must for a drive, this share of its stretches, by chance this unlikely.
_NEAR, _PERIOD, _FEWEST, _OFTEN, _CHANCE = 6e-3, 0.6, 8, 0.5, 1e-6
# Where one gear has play, fewer are enough for another: so many, by chance this unlikely. All
# drives share its effect on the motion, up to so many times as far from a change of sign.
_AS_WELL, _UNLIKELY, _ABOUT = 4, 1e-2, 2.0
# One that is so many times as large as those of play usually are is more than play; elsewhere one
# that is larger than this, since torques also come near zero without a change of sign.
_LARGER, _ELSEWHERE = 4.0, 1.5

Times = Float[np.ndarray, " _"]


def without_recurring(
    outliers: Outstanding, stretches: Sequence[Stretch], low_pass: LowPass | None, margin: float
) -> tuple[list[Stretch], list[LeftSpan]]:
    """Those of some stretches that have no reason in a drive, and all that play spoils.

    Args:
        outliers: what the stretches are of.
        margin: time about a change of sign, and about outliers there [s].
    """
    near = _NEAR + (_PERIOD / low_pass.motion_cutoff if low_pass else 0.0)
    peaks = np.array([stretch.peak for stretch in stretches])
    first = np.array([np.argmax(stretch.sizes) for stretch in stretches], dtype=int)
    size = np.array([stretch.size for stretch in stretches])
    friction, play = np.zeros((2, len(stretches)), dtype=bool)
    for j, times in enumerate(outliers.reversals):
        of_joint = (first == j) | (j >= len(outliers.turns))
        if _recurs(peaks[of_joint], times, near, outliers.inspected)[0]:
            friction |= of_joint & _beside(peaks, times, near)
    of_drives = [(first == i) & ~friction for i in range(len(outliers.turns))]
    rules = [
        _recurs(peaks[of_drive], times, near, outliers.inspected)
        for of_drive, times in zip(of_drives, outliers.turns, strict=True)
    ]
    spoilt: list[tuple[float, float, int]] = []
    if any(rule for rule, _ in rules):
        loose = [i for i, (_, as_well) in enumerate(rules) if as_well]
        usual = [of_drives[i] & _beside(peaks, outliers.turns[i], near) for i in loose]
        about = [_beside(peaks, times, _ABOUT * near) for times in outliers.turns]
        most = np.where(np.any(about, axis=0), _LARGER, _ELSEWHERE)
        play = ~friction & (size <= most * np.median(size[np.any(usual, axis=0)]))
        spoilt = [(t, t, i) for i in loose for t in outliers.turns[i].tolist()]
        for k in np.flatnonzero(play).tolist():
            gear = min(loose, key=lambda i: np.min(np.abs(outliers.turns[i] - peaks[k])))
            spoilt.append((stretches[k].start, stretches[k].end, gear))
    spans = [LeftSpan(a - margin, b + margin, BACKLASH, gear=gear) for a, b, gear in spoilt]
    rest = ~(friction | play)
    return [stretch for stretch, kept in zip(stretches, rest, strict=True) if kept], spans


def _beside(peaks: Times, times: Times, near: float) -> Bool[np.ndarray, " _"]:
    """Which peaks are near one of some times."""
    if not len(times):
        return np.zeros(len(peaks), dtype=bool)
    after = np.clip(np.searchsorted(times, peaks), 1, max(1, len(times) - 1))
    sides = np.stack([times[after - 1], times[np.minimum(after, len(times) - 1)]])
    return np.min(np.abs(sides - peaks), axis=0) <= near


def _recurs(peaks: Times, times: Times, near: float, duration: float) -> tuple[bool, bool]:
    """Whether peaks near some times are the rule; whether they may be, as for another drive."""
    if not len(peaks) or not len(times):
        return False, False
    gaps = np.minimum(np.diff(times), 2 * near)
    share = min(1.0, (gaps.sum() + 2 * near) / duration)
    hits = int(_beside(peaks, times, near).sum())
    chance = float(bdtrc(hits - 1, len(peaks), share))  # of so many or more
    often = hits >= max(_FEWEST, _OFTEN * len(peaks))
    return often and chance < _CHANCE, hits >= _AS_WELL and chance < _UNLIKELY
