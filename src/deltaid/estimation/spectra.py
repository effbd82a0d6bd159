"""Bandwidth of a motion, power density, white noise, quantization steps and jitter of signals."""

import numpy as np
from jaxtyping import Complex, Float

from deltaid.recording.spectrum import blackman_harris

# Most and least rows of a spectrum.
_MOST, _LEAST = 1 << 16, 16
# Samples of a stretch in which noise is measured.
_SHORT = 32
# Least power of a motion's line over noise; share of the speed's power below the bandwidth.
_ABOVE, _BELOW = 30.0, 0.99
# Least power of a line over a position's highest; less comes from encoder steps and lost rows.
_MOVES = 1e-4
# Numbers lie on a grid if this share of their distances are multiples of the least, within this
# share of it.
_ON_GRID, _OFF = 0.98, 0.05
# Largest number of steps over the whole range: more are indistinguishable from floating point.
_FINEST = 1e7
# Largest distance that is compared with the least one, as a multiple of it.
_FEW = 20.0
# Samples of a stretch for jitter, and least number of stretches.
_STRETCH, _FEWEST = 64, 10

Signals = Float[np.ndarray, "rows channels"]


def bandwidth(q: Signals, rate: float) -> float:
    """The frequency [Hz] below which nearly all of a motion's speed is; 0 at rest."""
    x = q[:_MOST]
    n, size = len(x), np.ptp(x, axis=0)
    if n < _LEAST or not size.any():
        return 0.0
    level = x - x[0] - np.linspace(0.0, 1.0, n)[:, None] * (x[-1] - x[0])
    level = (level - level.mean(axis=0)) * blackman_harris(n)[:, None]
    power = np.abs(np.fft.rfft(level, axis=0)) ** 2
    floor = np.median(power[3 * len(power) // 4 :], axis=0)
    power[power < np.maximum(_ABOVE * floor, _MOVES * power.max(axis=0))] = 0.0
    frequency = np.fft.rfftfreq(n, 1 / rate)
    total = np.cumsum(np.sum(power[:, size > 0] / size[size > 0] ** 2, axis=1) * frequency**2)
    return float(frequency[np.searchsorted(total, _BELOW * total[-1])]) if total[-1] else 0.0


def segments(
    x: Signals, rate: float, length: int, apart: int, *, level: bool = False
) -> tuple[Float[np.ndarray, " bins"], Complex[np.ndarray, "segments channels bins"]]:
    """Frequencies [Hz] and spectra of segments by Hann's window, their beginnings so many samples
    `apart`, without their means if they are to be `level`; scaled so that the mean of their squares
    is a one-sided power density [1/Hz] (Welch)."""
    parts = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)[::apart]
    if level:
        parts = parts - parts.mean(axis=2, keepdims=True)
    window = np.hanning(length + 2)[1:-1]
    scale = np.sqrt(2.0 / (rate * np.sum(window**2)))
    return np.fft.rfftfreq(length, 1 / rate), scale * np.fft.rfft(parts * window, axis=2)


def density(x: Signals, rate: float, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and one-sided power densities [1/Hz], one column a channel."""
    length = min(length, len(x))
    frequency, parts = segments(x, rate, length, max(1, length // 2), level=True)
    return frequency, np.mean(np.abs(parts) ** 2, axis=0).T


def white_noise(x: Signals) -> Float[np.ndarray, " channels"]:
    """Standard deviation of white noise by the upper half of the band.

    A median over short stretches, so that the few with steps of friction do not count.
    """
    parts = x[: len(x) // _SHORT * _SHORT].reshape(-1, _SHORT, x.shape[1])
    line = np.linspace(-1.0, 1.0, _SHORT)
    parts = parts - parts.mean(axis=1, keepdims=True)
    slope = np.einsum("psc,s->pc", parts, line) / (line @ line)
    window = np.hanning(_SHORT + 2)[1:-1]
    parts = (parts - slope[:, None] * line[:, None]) * window[:, None]
    power = np.abs(np.fft.rfft(parts, axis=1)[:, _SHORT // 4 + 1 : -1]) ** 2
    if not power.size:
        return np.zeros(x.shape[1])
    # The median of an exponential distribution is ln 2 times its mean.
    return np.sqrt(np.median(power, axis=(0, 1)) / np.log(2) / np.sum(window**2))


def step_of(x: Float[np.ndarray, " rows"]) -> float:
    """The step that numbers are whole multiples of, up to a constant; 0 without one."""
    reach = float(np.ptp(x))
    if reach == 0:
        return 0.0
    distances = np.diff(np.unique(np.round((x - x.min()) / reach, 10)) * reach)
    distances = distances[distances > reach / _FINEST]
    if not distances.size:
        return 0.0
    step = float(np.median(distances[distances < 1.5 * distances.min()]))
    multiples = distances[distances < _FEW * step] / step
    return step if np.mean(np.abs(multiples - np.round(multiples)) < _OFF) >= _ON_GRID else 0.0


def jitter(q: Signals, period: float) -> float:
    """Jitter of evenly stamped sampling instants [s, rms]; 0 if undetectable.

    A sample that is late by ε differs by q̇ ε, so fourth differences grow with speed in all drives.
    They must exceed noise at rest, and encoder steps.
    """
    rows = len(q) // _STRETCH * _STRETCH
    if rows < _FEWEST * _STRETCH:
        return 0.0
    fourth = np.diff(q, n=4, axis=0) / np.sqrt(70.0)
    fourth = np.pad(fourth, ((2, 2), (0, 0)))[:rows].reshape(-1, _STRETCH, q.shape[1])
    speed = np.gradient(q[:rows], period, axis=0).reshape(fourth.shape)
    noise, fast = np.mean(fourth[:, 2:-2] ** 2, axis=1), np.mean(speed**2, axis=1)
    jitters = []
    for power, speeds, angle in zip(noise.T, fast.T, q.T, strict=True):
        order = np.argsort(speeds)
        slow, quick = order[: len(order) // 5], order[len(order) // 2 :]
        still = float(np.median(power[slow]))
        excess = power[quick] - still
        if not speeds[quick].all() or np.median(excess) < max(still, step_of(angle) ** 2):
            return 0.0
        jitters.append(np.sqrt(max(float(np.median(excess / speeds[quick])), 0.0)))
    return float(min(jitters))
