"""What stands out again and again for a reason in a drive: friction and play.

Friction that the description has no law for stands out where a joint turns round, play where the
torque that a gear carries changes its sign. There a motor runs ahead through its play, and the
robot's torques follow from a motion that is not its own: in all drives, whether it stands out or
not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from deltaid.identification.outstanding import Outstanding, Stretch
from deltaid.recording.filter import LowPass

# A stretch belongs to a change of sign within so much time [s] and this share of the low-pass's
# period; so many must for a drive, this share of its stretches, by chance this unlikely.
_NEAR, _PERIOD, _FEWEST, _OFTEN, _CHANCE = 6e-3, 0.6, 8, 0.5, 1e-6
# Where one gear has play, fewer tell it of another: so many, by chance this unlikely. All drives
# share what play makes of the motion, up to so many times as far from a change of sign.
_AS_WELL, _UNLIKELY, _ABOUT = 4, 1e-2, 2.0
# One that is so many times as large as those of play usually are is more than play; elsewhere one
# that is larger than this, since torques also come near zero without a change of sign.
_LARGER, _ELSEWHERE = 4.0, 1.5


@dataclass(frozen=True, eq=False)
class Recurring:
    """Which stretches have a reason in a drive.

    Attributes:
        friction: those at reversals of joints.
        play: those where torques of gears with play reverse.
        loose: the drives whose gears these are.
    """

    friction: Bool[np.ndarray, " stretches"]
    play: Bool[np.ndarray, " stretches"]
    loose: tuple[int, ...] = ()

    def turns(
        self, seen: Outstanding, stretches: Sequence[Stretch], margin: float
    ) -> list[tuple[float, float, int]]:
        """First and last time of all that play spoils, and the drive whose play it is.

        Args:
            seen: what the stretches are of.
            margin: time about a change of sign, and about what stands out there [s].
        """
        spoilt = [(t - margin, t + margin, i) for i in self.loose for t in seen.turns[i].tolist()]
        for one, is_play in zip(stretches, self.play, strict=True):
            if is_play:
                apart = [np.min(np.abs(seen.turns[i] - one.peak)) for i in self.loose]
                own = self.loose[int(np.argmin(apart))]
                spoilt.append((one.start - margin, one.end + margin, own))
        return spoilt


def recurring(
    seen: Outstanding, stretches: Sequence[Stretch], low_pass: LowPass | None
) -> Recurring:
    """Stretches at reversals of joints and of the torques of gears, where they are so often."""
    near = _NEAR + (_PERIOD / low_pass.motion_cutoff if low_pass else 0.0)
    peaks = np.array([one.peak for one in stretches])
    first = np.array([int(np.argmax(np.abs(one.sizes))) for one in stretches], dtype=int)
    size = np.array([one.size for one in stretches])
    nothing = np.zeros(len(stretches), dtype=bool)
    friction = nothing.copy()
    for j, times in enumerate(seen.reversals):
        own = first == j if j < len(seen.turns) else ~nothing
        if _counted(peaks[own], times, near, seen.looked).recurs:
            friction |= own & _beside(peaks, times, near)
    of_drives = [(first == i) & ~friction for i in range(len(seen.turns))]
    told = [
        _counted(peaks[own], times, near, seen.looked)
        for own, times in zip(of_drives, seen.turns, strict=True)
    ]
    if not any(one.recurs for one in told):
        return Recurring(friction, nothing)
    loose = tuple(i for i, one in enumerate(told) if one.recurs_as_well)
    usual = [of_drives[i] & _beside(peaks, seen.turns[i], near) for i in loose]
    about = [_beside(peaks, times, _ABOUT * near) for times in seen.turns]
    size /= np.median(size[np.any(usual, axis=0)])
    small = size <= np.where(np.any(about, axis=0), _LARGER, _ELSEWHERE)
    return Recurring(friction, ~friction & small, loose)


@dataclass(frozen=True)
class _Counted:
    """Stretches of a drive, those near some times, and the chance that so many are."""

    stretches: int
    hits: int
    chance: float

    @property
    def recurs(self) -> bool:
        """Whether that is the rule."""
        often = self.hits >= max(_FEWEST, _OFTEN * self.stretches)
        return often and self.chance < _CHANCE

    @property
    def recurs_as_well(self) -> bool:
        """Whether it may be, as it is for another drive."""
        return self.hits >= _AS_WELL and self.chance < _UNLIKELY


def _beside(
    peaks: Float[np.ndarray, " _"], times: Float[np.ndarray, " _"], near: float
) -> Bool[np.ndarray, " _"]:
    """Which peaks are near one of some times."""
    if not len(times):
        return np.zeros(len(peaks), dtype=bool)
    after = np.clip(np.searchsorted(times, peaks), 1, max(1, len(times) - 1))
    sides = np.stack([times[after - 1], times[np.minimum(after, len(times) - 1)]])
    return np.min(np.abs(sides - peaks), axis=0) <= near


def _counted(
    peaks: Float[np.ndarray, " _"], times: Float[np.ndarray, " _"], near: float, duration: float
) -> _Counted:
    """How many peaks are near some times."""
    if not len(peaks) or not len(times):
        return _Counted(len(peaks), 0, 1.0)
    gaps = np.minimum(np.diff(times), 2 * near)
    share = min(1.0, (gaps.sum() + 2 * near) / duration)
    hits = int(_beside(peaks, times, near).sum())
    # The chance of so many or more.
    return _Counted(len(peaks), hits, float(bdtrc(hits - 1, len(peaks), share)))
