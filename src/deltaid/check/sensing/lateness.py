"""By how much a sensor is late against the motion, found with all that it leaves open."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.check.sensing.misfit import Found, Misfit
from deltaid.recording.time.resampling import interpolate

# Rounds of estimating and shifting; a delay is so large a priori [s].
_ROUNDS, _SIZE = 4, 0.05
# Stretches shorter than this, in samples, say nothing about time.
_SHORT = 12


@dataclass(frozen=True)
class Lag:
    """How late a sensor is.

    Attributes:
        delay, std: of what it shows against the motion [s].
        Q: misfit of what it shows so much earlier.
    """

    delay: float
    std: float
    Q: float


def lag_of(misfit: Misfit, plain: Found) -> Lag | None:
    """The delay of a sensor: y(t) = ŷ(t − δ), to first order about what has been found before."""
    sheet, T = misfit.sheet, np.eye(len(misfit.noise))
    if misfit.told.max() - misfit.told.min() > 1e-6:  # with holes there is no shifting
        return None
    found, delay, std = plain, 0.0, np.inf
    for _ in range(_ROUNDS):
        slope = -_slope(misfit.expected(found.theta), sheet.starts, sheet.period)
        early = _earlier(misfit, delay)
        found = early.of(T, beside=slope[:, None, :], spread=_SIZE)
        step, std = float(found.added[0]), float(found.std[0])
        delay += step
        if abs(step) < 0.1 * std:
            break
    return Lag(delay, std, _earlier(misfit, delay).of(T).Q)


def _earlier(misfit: Misfit, delay: float) -> Misfit:
    """The same with what is shown put earlier."""
    if delay == 0.0:
        return misfit
    sheet = misfit.sheet
    y = sheet.y.copy()
    ends = [*sheet.starts[1:].tolist(), y.shape[1]]
    for first, last in zip(sheet.starts.tolist(), ends, strict=True):
        if last - first >= _SHORT:
            time = np.arange(last - first) * sheet.period
            at = np.clip(time + delay, time[0], time[-1])
            part = sheet.y[misfit.channels, first:last]
            y[misfit.channels, first:last] = interpolate(time, part.T, at).T
    return Misfit(replace(sheet, y=y), misfit.sensor, misfit.channels)


def _slope(
    y: Float[np.ndarray, "channels samples"], starts: np.ndarray, period: float
) -> Float[np.ndarray, "channels samples"]:
    """Rates of change, stretch by stretch."""
    out = np.zeros_like(y)
    ends = [*starts[1:].tolist(), y.shape[1]]
    for first, last in zip(starts.tolist(), ends, strict=True):
        if last - first >= _SHORT:
            out[:, first:last] = np.gradient(y[:, first:last], period, axis=1)
    return out
