"""A stretch of a recording, filtered once, on which many hypotheses about its columns are tried.

All of them are affine maps and permutations of columns, and the filters are linear, so positions
are differentiated once and mapped afterwards. Poses and regressors are evaluated at a rate far
above the cut-off; the same low-pass then goes over regressor and torques, and both are thinned.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import detrend

from deltaid.checks.evidence import RawRows
from deltaid.recording.filter import LowPass, design_low_pass, samples_needed
from deltaid.recording.masks.masks import runs_of
from deltaid.recording.spectrum import HIGHEST, LOWEST_CUTOFF, SpectrumEstimate, apply, spectrum_of
from deltaid.recording.time.clock import HIGHEST_RATE

# The highest cut-off [Hz]: enough to distinguish columns.
_HIGHEST_CUTOFF = 30.0
# The share of the speeds' power that counts, and how far above it the cut-off is.
_MOST_POWER, _ABOVE = 0.999, 3.0
# Steps of friction need a grid that is fine whatever the cut-off [Hz].
_SLOWEST = 20.0
# A drive that is slower than this share of its largest speed for so long [s] stands still; samples
# without that must be so many, or all are taken.
_STILL, _REST, _AWAKE = 0.01, 0.1, 100
# RawRows missing in a row that are bridged by straight lines; more end a stretch.
_BRIDGED = 10

Values = Float[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class FilteredMotion:
    """Filtered positions with derivatives and filtered torques of one stretch."""

    q: Float[np.ndarray, "samples drives"]  # as mapped, evenly spaced
    qd: Float[np.ndarray, "samples drives"]
    qdd: Float[np.ndarray, "samples drives"]
    load: Values  # τ at these samples, which stands for what gears carry
    tau: Values  # that passed the low-pass, thinned
    # Where no drive rests that moves at other times: at rest friction balances any torque. All, if
    # too few would remain.
    awake: Bool[np.ndarray, " kept"]
    low_pass: LowPass  # from samples to kept ones
    recorded: Values  # q̇ of columns for it, if there are any

    def filtered(self, signals: Float[np.ndarray, "channels samples"]) -> Values:
        """Low-passed and thinned signals: (channels, kept)."""
        return apply(self.low_pass.smooth, signals, self.low_pass.decimation)[:, : len(self.tau)]

    def few(self, most: int) -> "FilteredMotion":
        """With so many samples at most that count, spread over the motion."""
        places = np.flatnonzero(self.awake)
        chosen = places[np.linspace(0, len(places) - 1, min(most, len(places))).astype(int)]
        return replace(self, awake=np.isin(np.arange(len(self.awake)), chosen))

    @cached_property
    def moves(self) -> Bool[np.ndarray, " drives"]:
        spread = np.ptp(self.q, axis=0)
        return spread > np.maximum(1e-9 * (1 + np.abs(self.q).max(axis=0)), 1e-4 * spread.max())


def motion(
    rows: RawRows, *, longest: float = 20.0, oversampled: float = 25.0
) -> FilteredMotion | None:
    """The liveliest stretch of a recording; None if it is too short, or without torque.

    Args:
        longest: that it lasts [s].
        oversampled: samples that a regressor is evaluated at, as a multiple of the cut-off:
            friction's steps fall on their grid.
    """
    if (even := _even(rows, longest)) is None:
        return None
    time, recorded = even
    parts = np.cumsum([rows.q.shape[1], rows.tau.shape[1]])
    q, tau, _ = np.split(recorded, parts, axis=1)
    rate = (len(time) - 1) / (time[-1] - time[0])
    cutoff = _cutoff(q, rate)
    if not tau.shape[1] or len(time) < samples_needed(cutoff, rate):
        return None
    full = design_low_pass(cutoff, rate, single=True)
    stride = max(1, int(rate / (oversampled * max(cutoff, _SLOWEST))))
    thinning = design_low_pass(cutoff, rate / stride, single=True)
    edge = full.margin - full.half
    smoothed = apply(full.smooth, recorded.T[:, edge : len(time) - edge], stride).T
    samples, load, speeds = np.split(smoothed, parts, axis=1)
    qd = apply(full.first, q.T, stride).T
    # The torques pass once, by a filter that is centred on the samples that the second one keeps.
    wide = tau.T[:, edge + thinning.half * stride : len(tau) - edge]
    count = -(-(len(samples) - len(thinning.smooth) + 1) // thinning.decimation)
    return FilteredMotion(
        q=samples,
        qd=qd,
        qdd=apply(full.second, q.T, stride).T,
        load=load,
        tau=apply(full.smooth, wide, stride * thinning.decimation).T[:count],
        awake=_awake(qd, rate / stride, thinning, count),
        low_pass=thinning,
        recorded=speeds,
    )


def _awake(qd: Values, rate: float, low_pass: LowPass, count: int) -> Bool[np.ndarray, " kept"]:
    """Kept samples whose filter window contains no rest of any drive."""
    asleep = np.zeros(len(qd))
    for speed in np.abs(qd).T:
        for first, last in runs_of(speed < _STILL * speed.max()):
            if last + 1 - first > _REST * rate:
                asleep[first : last + 1] = 1.0
    awake = apply(np.ones(len(low_pass.smooth)), asleep[None], low_pass.decimation)[0, :count] < 0.5
    return awake if awake.sum() > _AWAKE else np.ones(count, bool)


def _cutoff(q: Values, rate: float) -> float:
    """The usual one, or less: three times the frequency that 99.9 % of the speeds' power is below.
    Noise of coarse encoders, not white, lets the usual rule go too high for accelerations."""
    general = spectrum_of(q).cutoff(rate) or _HIGHEST_CUTOFF
    level = detrend(q, axis=0) * np.hanning(len(q))[:, None]
    frequency = np.fft.rfftfreq(len(q), 1 / rate)
    power = np.cumsum(np.abs(np.fft.rfft(level, axis=0) * frequency[:, None]) ** 2, axis=0)
    fastest = frequency[np.argmax(power >= _MOST_POWER * power[-1], axis=0)]
    # A drive at rest has noise alone, whose speeds are all at high frequencies.
    moving = max(fastest[fastest < _HIGHEST_CUTOFF], default=_HIGHEST_CUTOFF)
    highest = min(HIGHEST * rate, _HIGHEST_CUTOFF, _ABOVE * moving)
    return float(min(max(LOWEST_CUTOFF, min(general, highest)), HIGHEST * rate))


def _even(rows: RawRows, longest: float) -> tuple[Float[np.ndarray, " samples"], Values] | None:
    """Time and [q τ q̇] of the liveliest stretch without a gap, evenly spaced."""
    data = np.hstack([rows.q, rows.tau, rows.qd])
    keep = np.flatnonzero(np.isfinite(np.column_stack([rows.time, data])).all(axis=1))
    keep = keep[np.diff(np.maximum.accumulate(rows.time[keep]), prepend=-np.inf) > 0]
    time = rows.time[keep]
    if len(keep) < SpectrumEstimate.SHORTEST or not rows.q.shape[1]:
        return None
    step = float(np.median(np.diff(time)))
    if step < 1 / HIGHEST_RATE:  # it will be refused, whatever its columns are
        return None
    ends = np.flatnonzero(np.diff(time) > _BRIDGED * step)
    starts, stops = np.append(0, ends + 1), np.append(ends + 1, len(time))
    part = keep[_liveliest(rows.q[keep], starts, stops, int(longest / step))]
    time, data = rows.time[part], data[part]
    if len(part) < SpectrumEstimate.SHORTEST:
        return None
    if np.diff(time).max() < 1.5 * step:
        return time, data
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step) + 1)
    return grid, np.stack([np.interp(grid, time, column) for column in data.T], axis=1)


def _liveliest(q: Values, starts: np.ndarray, stops: np.ndarray, longest: int) -> slice:
    spread = np.ptp(q, axis=0)
    steps = np.abs(np.diff(q, axis=0, prepend=q[:1])) / np.where(spread > 0, spread, 1.0)
    travel = np.append(0.0, np.cumsum(steps.sum(axis=1)))
    ends = zip(starts, np.maximum(starts + 1, stops - longest + 1), strict=True)
    first = np.concatenate([np.arange(start, stop, max(1, longest // 20)) for start, stop in ends])
    last = np.minimum(first + longest, stops[np.searchsorted(starts, first, side="right") - 1])
    k = int(np.argmax(travel[last] - travel[first]))
    return slice(int(first[k]), int(last[k]))
