"""Zero-phase low-pass filtering and differentiation, and how the cut-off is chosen.

The low-pass is a symmetric FIR filter (windowed sinc, Kaiser window), so it delays nothing; its
first and second derivative are the same filter convolved with central differences of eighth order,
so q, q̇ and q̈ stay consistent. Filtered signals carry nothing above the cut-off and are thinned to
the rate that this allows.

Positions and the rows of the regression have a cut-off each. Torques and regressor pass the same
filter, so whatever it lets through, τ = Y p holds behind it; what a filter took from the positions
*before* Y was formed is missing in Y alone, and is a bias. So positions keep all that stands out of
their noise, and rows only what the motion shows the parameters by: noise of the accelerations, play
and ringing of gears lie above.

At a high rate the low-pass works in two stages, or it would grow with the rate: a short filter
(`lead`) thins to a rate that is still far above the cut-off, the low-pass itself works there, and
where values for every sample are wanted `lead` brings them back by interpolation. Either way it is
the same low-pass but for what `lead` lets through of its stop band, 120 dB.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.spectrum import HIGHEST, LOWEST_CUTOFF, apply

# Stop-band attenuation 80 dB; transition from 0.6 to 1.4 times the cut-off. The pass-band is flat
# to 1e-4. What it bends is a bias of all parameters: at 60 dB it showed beside a minute's noise.
_ATTENUATION, _TRANSITION = 80.0, 0.8
# Central differences of eighth order for the first and second derivative.
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
# Cut-offs as a share of the sampling rate at least.
_LOWEST = 1e-6
# The sampling rate below which positions cannot be differentiated [Hz].
LOWEST_RATE = LOWEST_CUTOFF / HIGHEST
# The rate between both stages at least [Hz], and as a multiple of the cut-off; and the stop-band
# attenuation [dB] of the filter that leads there.
_BETWEEN, _OVERSAMPLED, _LEAD_ATTENUATION = 4000.0, 32.0, 120.0


@dataclass(frozen=True, eq=False)
class LowPass:
    """A zero-phase low-pass with its derivatives, as FIR coefficients in the order of convolution.

    Attributes:
        cutoff: frequency of half amplitude of what goes over the rows [Hz].
        motion_cutoff: of what goes over positions; not below `cutoff`.
        rate: sampling rate of what goes in [Hz].
        stride: every how many samples are left by the first stage; 1 where there is a single one.
        lead: coefficients of the first stage, a single 1 where there is none.
        smooth: coefficients of the low-pass over rows, for samples `stride` apart.
        level, first, second: of the low-pass over positions and of its derivatives [1/s, 1/s²],
            all of one length.
        decimation: every how many of these samples of the output are kept.
        thinned: every how many samples of a recording are kept in the end.
        lead_half: samples that the first stage reaches to either side.
        half, margin, spread_half: samples, `stride` apart, that the low-pass over rows, the motion
            and `spread` reach to either side, and lose at either end.
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
        """Number of the row that belongs to the first filtered position."""
        return self.lead_half + self.stride * (self.margin + self.spread_half)

    @property
    def thinned(self) -> int:
        return self.stride * self.decimation

    @property
    def noise_gain(self) -> float:
        """What is left of the standard deviation of white noise: the norm of both stages."""
        return float(np.linalg.norm(self.response))

    @property
    def independent(self) -> float:
        """Share of the samples kept that white noise leaves independent: n Σ h², n = `thinned`."""
        return self.noise_gain**2 * self.thinned

    @property
    def speed_gain(self) -> float:
        """Standard deviation of the filtered derivative for white noise of deviation 1 [1/s]."""
        return float(np.linalg.norm(self._both_stages(self.first)))

    @cached_property
    def response(self) -> Float[np.ndarray, " response"]:
        """h, both stages as one filter of the samples that go in."""
        return self._both_stages(self.smooth)

    def _both_stages(self, taps: Float[np.ndarray, " taps"]) -> Float[np.ndarray, " response"]:
        apart = np.zeros((len(taps) - 1) * self.stride + 1)
        apart[:: self.stride] = taps
        return np.convolve(apart, self.lead)

    @cached_property
    def power(self) -> Float[np.ndarray, " response"]:
        """h² / Σ h²: how much each sample adds to the power of white noise behind the filter."""
        return self.response**2 / np.sum(self.response**2)

    @property
    def lead_half(self) -> int:
        return len(self.lead) // 2

    @property
    def spread_half(self) -> int:
        return -(-self.lead_half // self.stride)

    @property
    def lost(self) -> int:
        """Samples, `stride` apart, lost by all there is: derivatives, then the low-pass."""
        # And what a run of n · `stride` samples loses in the first stage.
        first_stage = -(-len(self.lead) // self.stride) - 1
        return 2 * (self.margin + self.half + self.spread_half) + first_stage

    @property
    def reach(self) -> int:
        """How many samples fewer than there are rows a segment gives."""
        return (self.lost - 1) * self.stride + len(self.lead)

    def samples_of(self, rows: int) -> int:
        """How many samples a window of so many rows has of its own."""
        apart = (rows - len(self.lead)) // self.stride + 1
        return max(0, apart - self.lost) * self.stride

    def leading(self, x: Float[np.ndarray, "channels all"]) -> Float[np.ndarray, "channels apart"]:
        """The first stage: of the samples those `stride` apart, as far as it fits entirely."""
        return x if self.stride == 1 else apply(self.lead, x, self.stride)

    def spread(self, x: Float[np.ndarray, "channels apart"]) -> Float[np.ndarray, "channels all"]:
        """Values for every sample from those `stride` apart, `spread_half` lost at either end."""
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
    """How many samples of a recording a low-pass is worth being applied to: eight times its margin.

    Raises:
        RecordingError: the cut-off is above a tenth of the sampling rate, or next to nothing.
    """
    if not _LOWEST * rate <= cutoff <= HIGHEST * rate:
        raise RecordingError(
            f"a cut-off of {cutoff:g} Hz does not go with a sampling rate of {rate:g} Hz",
            where=where,
            cure=f"choose one between {_LOWEST * rate:g} and {HIGHEST * rate:g} Hz",
        )
    taps = _taps(_ATTENUATION, _TRANSITION * cutoff / rate)
    return 8 * ((taps + len(_FIRST) - 1) // 2)


def design_low_pass(
    cutoff: float, rate: float, *, motion_cutoff: float = 0.0, single: bool = False
) -> LowPass:
    """A low-pass of `cutoff` Hz for data of `rate` Hz, in two stages if the rate is high.

    Args:
        motion_cutoff: that of positions [Hz], if it is higher.
        single: in one stage, whatever the rate.

    Raises:
        RecordingError: a cut-off is not below a tenth of the sampling rate.
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
    return LowPass(
        cutoff=cutoff,
        motion_cutoff=motion_cutoff,
        rate=rate,
        stride=stride,
        lead=_lead(_highest(motion_cutoff), rate, stride),
        smooth=smooth,
        level=np.pad(level, len(_FIRST) // 2),
        first=np.convolve(level, _FIRST[::-1]) * between,
        second=np.convolve(level, _SECOND) * between**2,
        decimation=max(1, int(between / (2 * _highest(cutoff)))),
    )


def no_filter(rate: float) -> LowPass:
    """The filter of recorded velocities and accelerations: all that goes in at `rate` Hz stays."""
    tap = np.ones(1)
    return LowPass(math.inf, math.inf, rate, 1, tap, tap, tap, tap, tap, decimation=1)


def _highest(cutoff: float) -> float:
    return (1 + 0.5 * _TRANSITION) * cutoff


def _lead(highest: float, rate: float, stride: int) -> Float[np.ndarray, " lead"]:
    """The filter before every `stride`-th sample is taken.

    It passes what the low-pass lets through (up to `highest`), and stops what would fold there.
    """
    if stride == 1:
        return np.ones(1)
    width = rate / stride - 2 * highest
    return _sinc(_LEAD_ATTENUATION, width / rate, 0.5 * rate / stride / rate)


def _taps(attenuation: float, width: float) -> int:
    """Odd number of taps of a Kaiser window, by Kaiser's formula.

    Args:
        attenuation: of the stop band, above 50 dB.
        width: of the transition, as a share of the sampling rate.
    """
    return math.ceil((attenuation - 7.95) / (2.285 * 2 * np.pi * width) + 1) | 1


def _sinc(attenuation: float, width: float, cutoff: float) -> Float[np.ndarray, " taps"]:
    """The ideal low-pass within a Kaiser window, of gain 1 at rest.

    Args:
        attenuation, width: of stop band and transition, as of `_taps`.
        cutoff: as a share of the sampling rate.
    """
    taps = _taps(attenuation, width)
    h = np.sinc(2 * cutoff * (np.arange(taps) - taps // 2))
    h *= np.kaiser(taps, 0.1102 * (attenuation - 8.7))  # β by Kaiser's formula
    return h / h.sum()
