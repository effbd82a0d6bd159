"""A structure that rings: a narrow line in the spectrum of what the model leaves of the torques."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from deltaid.check.spectra import density
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed, percent

# Lines are looked for above so many times the motion's fastest part, and above so many Hz: below,
# what a model lacks has lines of its own.
_ABOVE, _LOWEST = 3.0, 6.0
# A line stands so many times above its neighbours within a quarter of its frequency, is narrower
# than a tenth of it, and makes this share of the largest torque.
_STANDS, _NEAR, _NARROW, _LEAST = 12.0, 0.25, 0.1, 0.004
# Seconds of a spectrum's segment; segments at least.
_SECONDS, _SEGMENTS = 2.0, 6


def resonances(
    left: Float[np.ndarray, "rows dof"],
    rate: float,
    fastest: float,
    largest: Float[np.ndarray, " dof"],
    drives: tuple[str, ...],
) -> Iterator[Verdict]:
    """The highest line of all drives; drives that show it are named.

    Args:
        left: torques less those of the model, at the full rate.
        rate: Hz.
        fastest: of the motion [Hz].
        largest: torque of each drive.
        drives: their names.
    """
    length = int(min(_SECONDS * rate, 2 * len(left) / (_SEGMENTS + 1)))
    frequency, power = density(left, rate, max(length, 16))
    lines = [_line(frequency, p, max(_ABOVE * fastest, _LOWEST)) for p in power.T]
    shares = [
        np.sqrt(line[1]) / top if line else 0.0 for line, top in zip(lines, largest, strict=True)
    ]
    k = int(np.argmax(shares))
    line = lines[k]
    if line is None or shares[k] < _LEAST:
        yield Verdict("resonance", Grade.GOOD, "no line in what the model leaves of the torques")
        return
    same = [
        i
        for i, other in enumerate(lines)
        if other and shares[i] >= _LEAST and abs(other[0] / line[0] - 1) < _NARROW
    ]
    yield Verdict(
        "resonance",
        Grade.DOUBTFUL,
        f"a line at {line[0]:.3g} Hz with {percent(shares[k])} of {drives[k]}'s largest torque",
        subject=listed([drives[i] for i in same]) if len(same) < len(drives) else "",
        cause="struts, gears or frame ring there, or the drive's control loop does",
        cure="excite less near it and take a --cutoff below it; look for play and loose screws, or "
        "lower the gain of the control loop",
        number=float(line[0]),
        unit="Hz",
    )


def _line(
    frequency: Float[np.ndarray, " bins"], power: Float[np.ndarray, " bins"], lowest: float
) -> tuple[float, float] | None:
    """Frequency and power of the line that stands out most; None if none does."""
    inner = np.flatnonzero((frequency > lowest) & (frequency < 0.9 * frequency[-1]))
    peaks = inner[power[inner] >= power[np.maximum(inner - 1, 0)]]
    for i in peaks[np.argsort(-power[peaks])]:
        near = np.abs(frequency / frequency[i] - 1) < _NEAR
        level = _median(power[near])
        if power[i] < max(_STANDS * level, 1e-300):
            continue
        high = np.flatnonzero(near & (power > 0.5 * power[i]))
        if frequency[high[-1]] - frequency[high[0]] > _NARROW * frequency[i] + 2 * frequency[1]:
            continue
        band = np.abs(frequency - frequency[i]) <= 0.5 * _NARROW * frequency[i] + 2 * frequency[1]
        total = float(np.sum(np.maximum(power[band] - level, 0.0)) * frequency[1])
        return float(frequency[i]), total
    return None


def _median(x: Float[np.ndarray, " values"]) -> float:
    """`np.median` of some finite values, whose checks take longer than its work."""
    middle = [(len(x) - 1) // 2, len(x) // 2]
    return float(np.partition(x, middle)[middle].mean())
