"""Zero-phase low-pass filters and differentiators.

The low-pass is a symmetric FIR filter (windowed sinc, Kaiser window) without delay. Its first and
second derivative are the same filter convolved with central differences of eighth order, so q, q̇
and q̈ are consistent. Filtered signals have nothing above the cut-off and are thinned accordingly.

Positions and the rows of the regression have different cut-offs. Torques and regressor pass the
same filter, so τ = Y p holds behind it, whatever the cut-off. What a filter removes from positions
*before* Y is formed is missing in Y alone, which is a bias. So positions keep all frequencies at
which they exceed their noise. Rows keep the band of the motion only: noise of accelerations, play
and ringing of gears lie above.

At a high rate the low-pass has two stages, so that its length does not grow with the rate: a short
filter (`lead`) thins to a rate far above the cut-off, the low-pass works at that rate, and `lead`
interpolates where every sample is needed. The result differs by the stop band of `lead`, 120 dB.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.levels import FAINT
from deltaid.recording.spectrum import HIGHEST, LOWEST_CUTOFF, apply

# Stop-band attenuation [dB], and width of the transition around the cut-off, as a share of it. The
# pass band is flat to 1e-4. Ripple biases all parameters, at 60 dB visibly against the noise of a
# minute's recording.
_ATTENUATION, _TRANSITION = 80.0, 0.8
# Beginning of the stop band as a multiple of the cut-off.
_STOP = 1 + 0.5 * _TRANSITION
# Central differences of eighth order for the first and the second derivative.
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
# Fix of a recording that is shorter than the filter.
TOO_SHORT = (
    "give a longer one; without velocities and accelerations the filter's length is lost at either "
    "end"
)
# Least sampling rate at which positions can be differentiated [Hz].
LOWEST_RATE = LOWEST_CUTOFF / HIGHEST
# Least rate between the stages [Hz], least ratio of that rate to the cut-off, and stop-band
# attenuation of the first stage [dB].
_BETWEEN, _OVERSAMPLED, _LEAD_ATTENUATION = 4000.0, 32.0, 120.0


@dataclass(frozen=True, eq=False)
class LowPass:
    """Zero-phase low-pass with its derivatives, as FIR coefficients in the order of convolution.

    Attributes:
        cutoff: frequency of half amplitude of the low-pass over rows [Hz].
        motion_cutoff: the same of the low-pass over positions; not below `cutoff`.
        rate: sampling rate of the input [Hz].
        stride: decimation of the first stage; 1 with a single stage.
        lead: coefficients of the first stage; a single 1 without it.
        smooth: coefficients of the low-pass over rows, for samples `stride` apart.
        level, first, second: coefficients of the low-pass over positions and of its derivatives
            [1/s, 1/s²], all of one length.
        decimation: decimation of the second stage.
        thinned: decimation of both stages together.
        lead_half: reach of the first stage to either side [samples].
        half, margin, spread_half: reach to either side of the low-pass over rows, of that over
            positions and of `spread` [samples `stride` apart].
        first_row: rows at the beginning for which derivatives are unknown.
    """

    cutoff: float
    motion_cutoff: float
    rate: float
    stride: int
    lead: Float[np.ndarray, " lead"]
    smooth: Float[np.ndarray, " taps"]
    level: Float[np.ndarray, " longer"]
    first: Float[np.ndarray, " longer"]
    second: Float[np.ndarray, " longer"]
    decimation: int

    @property
    def half(self) -> int:
        return len(self.smooth) // 2

    @property
    def margin(self) -> int:
        return len(self.first) // 2

    @property
    def first_row(self) -> int:
        return self.lead_half + self.stride * (self.margin + self.spread_half)

    @property
    def thinned(self) -> int:
        return self.stride * self.decimation

    @property
    def noise_gain(self) -> float:
        """Gain of the standard deviation of white noise: the norm of `response`."""
        return float(np.linalg.norm(self.response))

    @property
    def independent(self) -> float:
        """Ratio of independent samples to kept ones: n Σ h², n = `thinned`."""
        return self.noise_gain**2 * self.thinned

    @property
    def speed_gain(self) -> float:
        """Standard deviation of the filtered derivative for unit white noise [1/s]."""
        return float(np.linalg.norm(self._both_stages(self.first)))

    @cached_property
    def response(self) -> Float[np.ndarray, " response"]:
        """Impulse response h: both stages as one filter of the input."""
        return self._both_stages(self.smooth)

    def _both_stages(self, taps: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " response"]:
        apart = np.zeros((len(taps) - 1) * self.stride + 1)
        apart[:: self.stride] = taps
        return np.convolve(apart, self.lead)

    @cached_property
    def power(self) -> Float[np.ndarray, " response"]:
        """Share h² / Σ h² of each sample in the power of white noise behind the filter."""
        return self.response**2 / np.sum(self.response**2)

    @property
    def lead_half(self) -> int:
        return len(self.lead) // 2

    @property
    def spread_half(self) -> int:
        return -(-self.lead_half // self.stride)

    @property
    def lost(self) -> int:
        """Samples `stride` apart that derivatives, low-pass and first stage lose together."""
        first_stage = -(-len(self.lead) // self.stride) - 1
        return 2 * (self.margin + self.half + self.spread_half) + first_stage

    @property
    def reach(self) -> int:
        """Rows that a segment loses."""
        return (self.lost - 1) * self.stride + len(self.lead)

    def samples_of(self, rows: int) -> int:
        """Number of inner samples of a window that is made from `rows` rows."""
        apart = (rows - len(self.lead)) // self.stride + 1
        return max(0, apart - self.lost) * self.stride

    def leading(self, x: Float[np.ndarray, "channels all"]) -> Float[np.ndarray, "channels apart"]:
        """Output of the first stage, `stride` samples apart, where it fits entirely."""
        return x if self.stride == 1 else apply(self.lead, x, self.stride)

    def spread(self, x: Float[np.ndarray, "channels apart"]) -> Float[np.ndarray, "channels all"]:
        """Interpolate values to every sample; `spread_half` values are lost at either end."""
        if self.stride == 1:
            return x
        near = 2 * self.spread_half + 1
        at = np.arange(self.stride) - self.stride * np.arange(near)[:, None]
        at += self.lead_half + self.stride * self.spread_half
        inside = (at >= 0) & (at < len(self.lead))
        weights = np.where(inside, self.lead[at * inside], 0.0) * self.stride
        around = np.lib.stride_tricks.sliding_window_view(x, near, axis=1)
        return (np.ascontiguousarray(around) @ weights).reshape(len(x), -1)


def samples_needed(cutoff: float, rate: float, where: str = "") -> int:
    """Fewest samples of a recording for a low-pass: eight times its margin.

    Raises:
        RecordingError: the cut-off is above a tenth of the sampling rate, or too far below it.
    """
    if not FAINT * rate <= cutoff <= HIGHEST * rate:
        raise RecordingError(
            f"a cut-off of {cutoff:g} Hz does not go with a sampling rate of {rate:g} Hz",
            where=where,
            cure=f"choose one between {FAINT * rate:g} and {HIGHEST * rate:g} Hz",
        )
    taps = _taps(_ATTENUATION, _TRANSITION * cutoff / rate)
    return 8 * ((taps + len(_FIRST) - 1) // 2)


def design_low_pass(
    cutoff: float, rate: float, *, motion_cutoff: float = 0.0, single: bool = False
) -> LowPass:
    """Low-pass of `cutoff` [Hz] at a sampling rate [Hz], in two stages if the rate is high.

    Args:
        motion_cutoff: cut-off of positions [Hz], if it is higher.
        single: whether the filter has one stage at any rate.

    Raises:
        RecordingError: a cut-off does not fit the sampling rate (`samples_needed`).
    """
    motion_cutoff = max(cutoff, motion_cutoff)
    samples_needed(cutoff, rate)
    samples_needed(motion_cutoff, rate)
    enough = max(_BETWEEN, _OVERSAMPLED * motion_cutoff)
    stride = 1 if single else max(1, int(rate / enough))
    between = rate / stride
    smooth, level = (
        _sinc(_ATTENUATION, _TRANSITION * share, share)
        for share in (cutoff / between, motion_cutoff / between)
    )
    lead = np.ones(1)
    if stride > 1:  # passes frequencies up to the stop band, stops those that would alias there
        width = (between - 2 * _STOP * motion_cutoff) / rate
        lead = _sinc(_LEAD_ATTENUATION, width, 0.5 * between / rate)
    return LowPass(
        cutoff=cutoff,
        motion_cutoff=motion_cutoff,
        rate=rate,
        stride=stride,
        lead=lead,
        smooth=smooth,
        level=np.pad(level, len(_FIRST) // 2),
        first=np.convolve(level, _FIRST[::-1]) * between,
        second=np.convolve(level, _SECOND) * between**2,
        decimation=max(1, int(between / (2 * (_STOP * cutoff)))),
    )


def no_filter(rate: float) -> LowPass:
    """Identity, for recorded velocities and accelerations."""
    tap = np.ones(1)
    return LowPass(math.inf, math.inf, rate, 1, tap, tap, tap, tap, tap, decimation=1)


def _taps(attenuation: float, width: float) -> int:
    """Odd number of taps of a Kaiser window, by Kaiser's formula.

    Args:
        attenuation: attenuation of the stop band, above 50 [dB].
        width: width of the transition, as a share of the sampling rate.
    """
    return math.ceil((attenuation - 7.95) / (2.285 * 2 * np.pi * width) + 1) | 1


def _sinc(attenuation: float, width: float, cutoff: float) -> Float[np.ndarray, " taps"]:
    """Ideal low-pass in a Kaiser window, with gain 1 at zero frequency.

    Args:
        attenuation, width: as in `_taps`.
        cutoff: cut-off, as a share of the sampling rate.
    """
    taps = _taps(attenuation, width)
    h = np.sinc(2 * cutoff * (np.arange(taps) - taps // 2))
    h *= np.kaiser(taps, 0.1102 * (attenuation - 8.7))  # β by Kaiser's formula
    return h / h.sum()
