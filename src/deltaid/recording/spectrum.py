"""Convolution of many channels as matrix products, and power spectra of positions.

The spectra determine the cut-offs of the filter.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from deltaid.levels import FAINT

# Largest cut-off as a share of the sampling rate: above it, differences err by more than 1e-4.
HIGHEST = 0.1
# Least cut-off that `SpectrumEstimate.cutoff` returns [Hz].
LOWEST_CUTOFF = 2.0
# Outputs per row of a matrix product, and numbers per product, which fit into the cache.
_OUTPUTS, _CHUNK = 16, 1 << 17
# Samples per segment of a spectrum.
SEGMENT = 4096
# Least ratio of a motion's power to that of the noise: 20 dB; and ratio of noise by an encoder's
# steps to the noise in the upper half of the band, above which noise counts as coloured.
_ABOVE, _COLOURED = 100.0, 4.0
# Share of the power of speeds within the bandwidth.
NEARLY_ALL = 0.999
# Coefficients of cos 0, cos 2πk/n, cos 4πk/n, …
_BLACKMAN_HARRIS = np.array([0.35875, -0.48829, 0.14128, -0.01168])


def apply(
    taps: Float[np.ndarray, " taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int = 1,
) -> Float[np.ndarray, "channels kept"]:
    """Convolve each channel where the filter fits entirely, and decimate."""
    return convolve(taps[None], x, decimation)[0]


def convolve(
    taps: Float[np.ndarray, "filters taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int = 1,
) -> Float[np.ndarray, "filters channels kept"]:
    """Convolve each channel with several filters of equal length, as `apply` does with one.

    Neighbouring outputs of all filters are a banded matrix times the samples that they depend on.
    Such matrix products are an order of magnitude faster than a loop over taps.
    """
    filters, length = taps.shape
    if length == 1:
        return taps[:, :, None] * x[:, ::decimation]
    channels, samples = x.shape
    kept = max(0, -(-(samples - length + 1) // decimation))
    if not channels or not kept:
        return np.zeros((filters, channels, kept))
    span = (_OUTPUTS - 1) * decimation + length
    band = _band(taps, decimation, span)
    step = _OUTPUTS * decimation
    blocks = -(-kept // _OUTPUTS)
    padded = np.zeros((channels, span))  # samples of the last block
    end = x[:, (blocks - 1) * step :]
    padded[:, : min(end.shape[1], span)] = end[:, :span]
    out = np.empty((filters, channels, blocks * _OUTPUTS))

    def fill(start: int, under: Float[np.ndarray, "channels blocks span"]) -> None:
        product = np.ascontiguousarray(under).reshape(-1, span) @ band
        shaped = product.reshape(channels, -1, filters, _OUTPUTS).transpose(2, 0, 1, 3)
        width = under.shape[1] * _OUTPUTS
        out[:, :, start * _OUTPUTS :][:, :, :width] = shaped.reshape(filters, channels, width)

    if blocks > 1:
        under = np.lib.stride_tricks.sliding_window_view(x, span, axis=1)[:, ::step]
        at_once = max(1, _CHUNK // (channels * span))
        for start in range(0, blocks - 1, at_once):
            fill(start, under[:, start : min(start + at_once, blocks - 1)])
    fill(blocks - 1, padded[:, None])
    return out[:, :, :kept]


def _band(
    taps: Float[np.ndarray, "filters taps"], decimation: int, span: int
) -> Float[np.ndarray, "span outputs"]:
    """Matrix of a block: column k of a filter holds its reversed taps from row k·decimation on."""
    filters, length = taps.shape
    band = np.zeros((span, filters, _OUTPUTS))
    column = np.arange(_OUTPUTS)
    band[column * decimation + np.arange(length)[:, None], :, column] = taps[:, ::-1].T[:, None]
    return band.reshape(span, -1)


@dataclass(frozen=True, eq=False)
class SpectrumEstimate:
    """Power spectra of positions, summed over segments.

    Estimates add up; partial segments count only if no segment is full.

    Attributes:
        power: sum of the power over all segments.
        segments: number of segments.
        are_full: whether segments have `SEGMENT` samples.
        step: smallest change from one sample to the next; infinite without changes.
        changes: share of samples at which each position changes, times the number of segments.
    """

    power: Float[np.ndarray, "dof frequencies"]
    segments: int
    are_full: bool
    step: Float[np.ndarray, " dof"]
    changes: Float[np.ndarray, " dof"]

    SHORTEST = 256

    def __add__(self, other: "SpectrumEstimate") -> "SpectrumEstimate":
        if self.are_full != other.are_full:
            return self if self.are_full else other
        return SpectrumEstimate(
            self.power + other.power,
            self.segments + other.segments,
            self.are_full,
            np.minimum(self.step, other.step),
            self.changes + other.changes,
        )

    @property
    def noise(self) -> Float[np.ndarray, " dof"]:
        """Standard deviation of each position's noise, by the noise floor of its spectrum."""
        floor = self._floor / max(self.segments, 1)
        return np.sqrt(floor / np.sum(blackman_harris(SEGMENT) ** 2))

    @property
    def _floor(self) -> Float[np.ndarray, " dof"]:
        return np.median(self.power[:, SEGMENT // 4 :], axis=1)

    @property
    def _noise_floor(self) -> Float[np.ndarray, " dof"]:
        """Power of the noise per bin in the band of the motion.

        Steps Δ of an encoder are noise of variance Δ²/12. If the position stays on each step for
        many samples, the frequencies of this noise are below the rate of changes.
        """
        floor, changes = self._floor, self.changes / self.segments
        step = np.where(np.isfinite(self.step), self.step, 0.0)
        white = step**2 / 12 * np.sum(blackman_harris(SEGMENT) ** 2) * self.segments
        steps = white / np.maximum(2 * changes, 1 / SEGMENT)
        return np.where((2 * changes < 1) & (steps > _COLOURED * floor), steps, floor)

    def cutoff(self, rate: float) -> float | None:
        """Twice the highest frequency at which a drive's position exceeds its noise by 20 dB [Hz].

        Twice, because torques have products of velocities. The noise floor is the median power in
        the upper half of the band, or the power of a coarse encoder's steps. Resting drives do not
        count: one that flickers between two steps exceeds its floor at all frequencies. None
        without a segment.
        """
        if not self.segments:
            return None
        frequency = np.fft.rfftfreq(SEGMENT, 1 / rate)
        above = np.flatnonzero(self._above_noise.any(axis=0))
        top = frequency[above[-1]] if above.size else frequency[1]
        return float(np.clip(2 * top, LOWEST_CUTOFF, HIGHEST * rate))

    def bandwidth(self, rate: float) -> float | None:
        """Frequency below which 99.9 % of the power of speeds lies, with equal weight of drives
        [Hz].

        Only power above the noise of positions counts. None without a segment.
        """
        if not self.segments:
            return None
        frequency = np.fft.rfftfreq(SEGMENT, 1 / rate)
        speed = np.where(self._above_noise, self.power, 0.0) * frequency**2
        total = speed.sum(axis=1, keepdims=True)
        share = np.cumsum((speed / np.where(total > 0, total, 1.0)).sum(axis=0))
        most = int(np.searchsorted(share, NEARLY_ALL * share[-1]))
        return float(frequency[max(most - 2, 1)])  # the window widens a wave by two bins

    @property
    def _above_noise(self) -> Bool[np.ndarray, "dof frequencies"]:
        """Frequencies at which a position exceeds its noise; none for a resting drive."""
        power = self.power.sum(axis=1, keepdims=True)
        loud = self.power > _ABOVE * self._noise_floor[:, None]
        return loud & (power > FAINT * power.max())


def spectrum_of(q: Float[np.ndarray, "samples dof"]) -> SpectrumEstimate:
    """Spectra of consecutive samples; a partial segment counts only without a full one."""
    starts = range(0, len(q) - SEGMENT + 1, SEGMENT)
    power = np.zeros((q.shape[1], SEGMENT // 2 + 1))
    for start in starts:
        power += _segment(q[start : start + SEGMENT])
    if not starts and len(q) >= SpectrumEstimate.SHORTEST:
        power += _segment(q)
    segments = len(starts) or int(power.any())
    change = np.abs(np.diff(q, axis=0))
    step = np.where(change > 0, change, np.inf).min(axis=0, initial=np.inf)
    changes = segments * (np.count_nonzero(change, axis=0) / max(len(change), 1))
    return SpectrumEstimate(power, segments, bool(starts), step, changes)


def _segment(q: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "dof frequencies"]:
    t = np.arange(len(q)) - 0.5 * (len(q) - 1)
    level = q - q.mean(axis=0)
    level -= np.outer(t, t @ level / (t @ t))  # subtracts the straight line
    return np.abs(np.fft.rfft(level.T * blackman_harris(len(q)), SEGMENT, axis=1)) ** 2


@cache
def blackman_harris(length: int) -> Float[np.ndarray, " length"]:
    """Blackman–Harris window; with side lobes of −92 dB, motion does not leak into the noise
    floor."""
    turns = np.outer(np.arange(length), np.arange(len(_BLACKMAN_HARRIS)))
    return np.cos(2 * np.pi / length * turns) @ _BLACKMAN_HARRIS
