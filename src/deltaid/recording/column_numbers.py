"""What columns of a foreign recording mean, by their first numbers.

Numbers say whether a column may be a time, and in which unit; whether velocities are the
derivatives of positions, and which unit follows from that.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from deltaid.recording.units import factor_among

Signal = Float[np.ndarray, " rows"]
# Share of steps of a time that may run backwards, as damage.
_BACKWARDS = 0.01
# Usual steps that can be of one unit only, recorded at 10 Hz to 20 kHz: seconds up to the step
# that would be 100 kHz in ms; ms where seconds would be slower than 10 Hz and the number is no
# cycle's; ns where ticks of 100 ns would be slower.
_STEPS = (("s", 5e-5, 0.0100001), ("ms", 0.11, 0.9), ("ns", 1.1e6, 1e8))
# Rows on either side over which a position is differentiated, and a velocity averaged.
_HALF = 4
# Correlation of a derivative at least, and how far factors of drives or units may differ.
_SAME, _APART = 0.98, 0.03
_UNITS = {
    ("time", False): ("s", "ms", "us", "ns"),
    ("position", False): ("rad", "deg", "rev"),
    ("velocity", False): ("rad/s", "deg/s", "rpm", "rev/s"),
    ("position", True): ("m", "mm"),
    ("velocity", True): ("m/s", "mm/s"),
}


def time_unit(start: Signal | None) -> str | None:
    """The only unit that fits a column as a time; empty if several do, None if it is no time."""
    if start is None or len(start) < 2:
        return ""
    steps = np.diff(start)
    if not np.isfinite(start).all() or start[-1] <= start[0] or np.mean(steps < 0) > _BACKWARDS:
        return None
    usual = float(np.median(steps[steps > 0]))
    return next((unit for unit, low, high in _STEPS if low <= usual <= high), "")


def derivative_factor(
    time: Signal, positions: Sequence[Signal | None], velocities: Sequence[Signal | None]
) -> float | None:
    """How many times larger the derivative of positions is than what may be velocities; None where
    these are no derivatives, or nothing moves."""
    factors = list[float]()
    for position, velocity in zip(positions, velocities, strict=True):
        if position is None or velocity is None or len(time) <= 4 * _HALF:
            return None
        width = 2 * _HALF
        with np.errstate(all="ignore"):
            slope = (position[width:] - position[:-width]) / (time[width:] - time[:-width])
        mean = np.convolve(velocity, np.full(width + 1, 1 / (width + 1)), "valid")
        finite = np.isfinite(slope) & np.isfinite(mean)
        slope, mean = slope[finite], mean[finite]
        size = math.sqrt(float(slope @ slope) * float(mean @ mean))
        if size == 0 or abs(float(slope @ mean)) < _SAME * size:
            return None
        factors.append(abs(float(slope @ mean)) / float(mean @ mean))
    middle = float(np.median(factors)) if factors else 0.0
    near = bool(factors) and all(abs(factor / middle - 1) < _APART for factor in factors)
    return middle if near else None


def fitting_units(
    factor: float, units: tuple[str, str, str], unknown: str, *, slides: bool = False
) -> list[str]:
    """Units of the unknown quantity with which velocities are the derivatives of positions.

    Args:
        factor: of `derivative_factor`.
        units: of position, velocity and time.
        unknown: which of these is unknown; empty to ask whether all three fit, for which the answer
            is the unit of time or nothing.
        slides: whether the drives do.
    """
    place = ("position", "velocity", "time").index(unknown) if unknown else 2
    tried = _UNITS[unknown, slides and unknown != "time"] if unknown else (units[2],)
    fitting = list[str]()
    for unit in tried:
        position, velocity, time = (*units[:place], unit, *units[place + 1 :])
        q, v = factor_among(position, "rad", "m"), factor_among(velocity, "rad/s", "m/s")
        t = factor_among(time, "s")
        if q and v and t and abs(factor * q / (v * t) - 1) < _APART:
            fitting.append(unit)
    return fitting
