"""Power spectra of recorded positions, from which the cut-off of the filter is chosen."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from deltaid.recording.filter import HIGHEST, LOWEST_CUTOFF

# Samples of a segment.
_SEGMENT = 4096
_BLACKMAN_HARRIS = np.array([0.35875, -0.48829, 0.14128, -0.01168])  # of cos 0, 2πk/n, 4πk/n, …


@dataclass(frozen=True)
class Power:
    """Power of the positions in some segments.

    Attributes:
        sum: over the segments.
        segments: how many; none where consecutive samples are fewer than a segment.
    """

    sum: Float[np.ndarray, "dof frequencies"]
    segments: int


def power_of(q: Float[np.ndarray, "samples dof"]) -> Power:
    """Power of consecutive samples; a remainder shorter than a segment is left out, unless it is
    all there is."""
    starts = range(0, len(q) - _SEGMENT + 1, _SEGMENT)
    total = np.zeros((q.shape[1], _SEGMENT // 2 + 1))
    for start in starts:
        total += _segment(q[start : start + _SEGMENT])
    if not starts and len(q) >= SpectrumEstimate.SHORTEST:
        total += _segment(q)
    return Power(total, len(starts))


def _segment(q: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "dof frequencies"]:
    # Curvature suppresses the leakage of the slow, large motion into the noise floor.
    t = np.arange(len(q)) - 0.5 * (len(q) - 1)
    level = q - q.mean(axis=0)
    level -= np.outer(t, t @ level / (t @ t))  # without its straight line
    return np.abs(np.fft.rfft(level.T * _blackman_harris(len(q)), _SEGMENT, axis=1)) ** 2


@cache
def _blackman_harris(length: int) -> Float[np.ndarray, " length"]:
    turns = np.outer(np.arange(length), np.arange(len(_BLACKMAN_HARRIS)))
    return np.cos(2 * np.pi / length * turns) @ _BLACKMAN_HARRIS


class SpectrumEstimate:
    """Power spectra of positions, averaged over segments, from which the cut-off is chosen."""

    SHORTEST = 256

    def __init__(self, dof: int) -> None:
        self._power = np.zeros((dof, _SEGMENT // 2 + 1))
        self._segments = 0

    def add(self, power: Power) -> None:
        """Take in the power of consecutive samples."""
        if power.segments or not self._segments:
            self._power += power.sum
            self._segments += power.segments or int(power.sum.any())

    @property
    def noise(self) -> Float[np.ndarray, " dof"]:
        """Standard deviation of each position's noise, by its floor; 0 without a full segment."""
        floor = np.median(self._power[:, _SEGMENT // 4 :], axis=1) / max(self._segments, 1)
        return np.sqrt(floor / np.sum(_blackman_harris(_SEGMENT) ** 2))

    def cutoff(self, rate: float) -> float | None:
        """Twice the highest frequency at which a drive's position stands 20 dB over its noise.

        The noise floor is the median power of the upper half of the band. Twice, because torques
        hold products of velocities. None without a full segment.
        """
        if not self._segments:
            return None
        frequency = np.fft.rfftfreq(_SEGMENT, 1 / rate)
        floor = np.median(self._power[:, len(frequency) // 2 :], axis=1, keepdims=True)
        above = np.flatnonzero((self._power > 100 * floor).any(axis=0))
        top = frequency[above[-1]] if above.size else frequency[1]
        return float(np.clip(2 * top, LOWEST_CUTOFF, HIGHEST * rate))
