"""A structure that rings: a narrow line in the spectrum of what the model leaves of the torques."""

import numpy as np
from jaxtyping import Float

from deltaid.check.spectra import bandwidth, density, white_noise
from deltaid.identification.study import Study
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed, percent
from deltaid.recording.windows import Samples

# Lines are looked for above so many times the motion's fastest part, and above so many Hz: below,
# what a model lacks has lines of its own.
_ABOVE, _LOWEST = 3.0, 6.0
# A line stands so many times above its neighbours within a quarter of its frequency, is narrower
# than a tenth of it, and makes this share of the largest torque.
_STANDS, _NEAR, _NARROW, _LEAST = 12.0, 0.25, 0.1, 0.004
# Seconds of a spectrum's segment; segments at least.
_SECONDS, _SEGMENTS = 2.0, 6


def largest_torques(study: Study) -> Float[np.ndarray, " dof"]:
    """Of the model, each drive's."""
    return np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)


def white_share(study: Study) -> Float[np.ndarray, " dof"]:
    """What white noise of the torques would leave after the filter."""
    low_pass = study.fit.trace.low_pass
    return white_noise(_unexplained(study), low_pass.rate) * low_pass.noise_gain


def _longest(study: Study) -> Samples:
    """The longest stretch without a gap."""
    return max(study.fit.trace.stretches, key=lambda stretch: len(stretch.time))


def _unexplained(study: Study) -> Float[np.ndarray, "samples dof"]:
    """Torques less those of the model, of this stretch, nothing put back or filtered."""
    w, dynamics = _longest(study), study.fit.trace.dynamics
    left = w.tau - dynamics.torque(w.z, w.qd, w.qdd, study.fit.p)
    return np.where(w.weights > 0, left, 0.0)


def resonance(study: Study) -> Verdict:
    """The highest line of all drives; drives that show it are named."""
    trace, drives, left = study.fit.trace, study.fit.drives, _unexplained(study)
    rate, q = trace.low_pass.rate, trace.dynamics.kinematics.inverse(_longest(study).z)
    length = int(min(_SECONDS * rate, 2 * len(left) / (_SEGMENTS + 1)))
    frequency, power = density(left, rate, max(length, 16))
    lowest = max(_ABOVE * bandwidth(q, rate), _LOWEST)
    lines = np.array([_line(frequency, own, lowest) for own in power.T])
    shares = np.sqrt(lines[:, 1]) / largest_torques(study)
    k = int(np.argmax(shares))
    if shares[k] < _LEAST:
        return Verdict("resonance", Grade.GOOD, "no line in what the model leaves of the torques")
    at = float(lines[k, 0])
    same = (shares >= _LEAST) & (np.abs(lines[:, 0] / at - 1) < _NARROW)
    return Verdict(
        "resonance",
        Grade.DOUBTFUL,
        f"a line at {at:.3g} Hz with {percent(shares[k])} of {drives[k]}'s largest torque",
        "" if same.all() else listed([drives[i] for i in np.flatnonzero(same)]),
        "struts, gears or frame ring there, or the drive's control loop does",
        "excite less near it and take a --cutoff below it; look for play and loose screws, or "
        "lower the gain of the control loop",
        number=at,
        unit="Hz",
    )


def _line(
    frequency: Float[np.ndarray, " bins"], power: Float[np.ndarray, " bins"], lowest: float
) -> tuple[float, float]:
    """Frequency and power of the line that stands out most; zeros if none does."""
    inner = np.flatnonzero((frequency > lowest) & (frequency < 0.9 * frequency[-1]))
    peaks = inner[power[inner] >= power[np.maximum(inner - 1, 0)]]
    for i in peaks[np.argsort(-power[peaks])]:
        near = np.abs(frequency / frequency[i] - 1) < _NEAR
        x = power[near]
        middle = [(len(x) - 1) // 2, len(x) // 2]  # of np.median, whose checks take longer
        level = float(np.partition(x, middle)[middle].mean())
        if power[i] < max(_STANDS * level, 1e-300):
            continue
        high, wide = np.flatnonzero(near & (power > 0.5 * power[i])), _NARROW * frequency[i]
        if frequency[high[-1]] - frequency[high[0]] > wide + 2 * frequency[1]:
            continue
        band = np.abs(frequency - frequency[i]) <= 0.5 * wide + 2 * frequency[1]
        total = float(np.sum(np.maximum(power[band] - level, 0.0)) * frequency[1])
        return float(frequency[i]), total
    return 0.0, 0.0
