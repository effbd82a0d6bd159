"""Zero-phase low-pass filtering and differentiation, and how the cut-off is chosen.

The low-pass is a symmetric FIR filter (windowed sinc, Kaiser window), so it delays nothing; its
first and second derivative are the same filter convolved with central differences of eighth order,
so q, q̇ and q̈ stay consistent. Filtered signals carry nothing above the cut-off and are thinned to
the rate that this allows.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import signal

from deltaid.errors import RecordingError

# Stop-band attenuation 80 dB; transition from 0.6 to 1.4 times the cut-off. The pass-band is flat
# to 1e-4. What it bends is a bias of all parameters: at 60 dB it showed beside a minute's noise.
_ATTENUATION, _TRANSITION = 80.0, 0.8
# Central differences of eighth order for the first and second derivative.
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
# Above a tenth of the sampling rate the differences are no longer exact to 1e-4.
_LOWEST, _HIGHEST = 1e-6, 0.1
_LOWEST_CUTOFF = 2.0  # Hz, of those that are chosen by rule
_SEGMENT = 4096


@dataclass(frozen=True)
class LowPass:
    """A zero-phase low-pass with its derivatives, as FIR coefficients in the order of convolution.

    Attributes:
        cutoff: frequency of half amplitude [Hz].
        rate: sampling rate of what goes in [Hz].
        smooth: coefficients of the filter; `first` and `second` of its derivatives [1/s, 1/s²].
        decimation: every how many samples of the output are kept.
    """

    cutoff: float
    rate: float
    smooth: Float[np.ndarray, " taps"]
    first: Float[np.ndarray, " longer"]
    second: Float[np.ndarray, " longer"]
    decimation: int

    @property
    def margin(self) -> int:
        """Samples lost at either end by a derivative."""
        return len(self.first) // 2


def lowest_rate() -> float:
    """The sampling rate [Hz] below which positions cannot be differentiated."""
    return _LOWEST_CUTOFF / _HIGHEST


def samples_needed(cutoff: float, rate: float, where: str = "") -> int:
    """How many samples of a recording a low-pass is worth being applied to: eight times its margin.

    Raises:
        RecordingError: the cut-off is above a tenth of the sampling rate, or next to nothing.
    """
    if not _LOWEST * rate <= cutoff <= _HIGHEST * rate:
        raise RecordingError(
            f"a cut-off of {cutoff:g} Hz does not go with a sampling rate of {rate:g} Hz",
            where=where,
            cure=f"choose one between {_LOWEST * rate:g} and {_HIGHEST * rate:g} Hz",
        )
    taps, _ = _kaiser(cutoff, rate)
    return 8 * ((taps + len(_FIRST) - 1) // 2)


def design_low_pass(cutoff: float, rate: float) -> LowPass:
    """A low-pass of `cutoff` Hz for data of `rate` Hz.

    Raises:
        RecordingError: the cut-off is not below a tenth of the sampling rate.
    """
    samples_needed(cutoff, rate)
    taps, beta = _kaiser(cutoff, rate)
    smooth = signal.firwin(taps, cutoff, window=("kaiser", beta), fs=rate)
    highest = (1 + 0.5 * _TRANSITION) * cutoff
    return LowPass(
        cutoff=cutoff,
        rate=rate,
        smooth=smooth,
        first=np.convolve(smooth, _FIRST[::-1]) * rate,
        second=np.convolve(smooth, _SECOND) * rate**2,
        decimation=max(1, int(rate / (2 * highest))),
    )


def _kaiser(cutoff: float, rate: float) -> tuple[int, float]:
    """Odd number of taps and shape of the Kaiser window."""
    taps, beta = signal.kaiserord(_ATTENUATION, _TRANSITION * cutoff / (0.5 * rate))
    return int(taps) | 1, float(beta)


def apply(
    taps: Float[np.ndarray, " taps"],
    x: Float[np.ndarray, "channels samples"],
    decimation: int = 1,
) -> Float[np.ndarray, "channels kept"]:
    """Convolve each channel where the filter fits entirely; keep every `decimation`-th sample."""
    # upfirdn keeps samples 0, D, 2D, … of the full convolution, so let one of them be the first
    # at which the filter fits.
    skip = -(len(taps) - 1) % decimation
    first = (len(taps) - 1 + skip) // decimation
    kept = -(-(x.shape[1] - len(taps) + 1) // decimation)
    padded = np.pad(x, ((0, 0), (skip, 0))) if skip else x
    return signal.upfirdn(taps, padded, down=decimation, axis=1)[:, first : first + kept]


class SpectrumEstimate:
    """Power spectra of positions, averaged over segments, from which the cut-off is chosen."""

    SHORTEST = 256

    def __init__(self, dof: int) -> None:
        self._power = np.zeros((dof, _SEGMENT // 2 + 1))
        self._segments = 0

    def add(self, q: Float[np.ndarray, "samples dof"]) -> None:
        """Take in consecutive samples; a remainder shorter than a segment is left out, unless it
        is all there is."""
        for start in range(0, len(q) - _SEGMENT + 1, _SEGMENT):
            self._add_segment(q[start : start + _SEGMENT])
        if not self._segments and len(q) >= self.SHORTEST:
            self._add_segment(q)

    def _add_segment(self, q: Float[np.ndarray, "samples dof"]) -> None:
        # Curvature suppresses the leakage of the slow, large motion into the noise floor.
        window = signal.windows.blackmanharris(len(q), sym=False)
        centred = signal.detrend(q, axis=0) * window[:, None]
        self._power += np.abs(np.fft.rfft(centred, _SEGMENT, axis=0).T) ** 2
        self._segments += 1

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
        return float(np.clip(2 * top, _LOWEST_CUTOFF, _HIGHEST * rate))
