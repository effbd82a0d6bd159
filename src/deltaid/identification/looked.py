"""A window of a recording looked at: whether anything comes near to standing out, and what does."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.identification.expectation import NOISE, Expectation, length
from deltaid.identification.slack import joint_rates
from deltaid.identification.spikes import spikes
from deltaid.recording.windows import Window

# What must be reached to stand out, in standard deviations; and by restless torque, in those of
# single samples.
STRONG, ROUGH = 6.0, 12.0
# Samples of a mean that tell restless torque.
_ENOUGH = 5
# A window is looked at closely where anything comes this near to standing out; to see that, torques
# are expected at so many places over the time of a mean.
_NEAR, _PLACES = 0.8, 2


@dataclass(frozen=True, eq=False)
class Looked:
    """A window's own samples: residual's mean, in standard deviations, spikes, changes of the signs
    of gears' torques and of joints' speeds, and the torques that the low-pass took off."""

    time: Float[np.ndarray, " samples"]
    z: Float[np.ndarray, "samples dof"]
    mean: Float[np.ndarray, "dof samples"]
    size: Float[np.ndarray, "dof samples"]
    rough: Float[np.ndarray, "dof samples"]
    spikes: Bool[np.ndarray, "dof samples"]
    jump: Float[np.ndarray, "dof samples"]
    signs: Bool[np.ndarray, "changes samples"]
    taken: Float[np.ndarray, "dof samples"]
    speed: Float[np.ndarray, "dof samples"]

    def part(self, which: slice) -> "Looked":
        own = (x[:, which] for x in self.by_drive)
        return Looked(self.time[which], self.z[which], *own)

    @property
    def by_drive(self) -> tuple[np.ndarray, ...]:
        """All but times and places."""
        first = (self.mean, self.size, self.rough, self.spikes, self.jump)
        return *first, self.signs, self.taken, self.speed


def glance(expected: Expectation, window: Window) -> "tuple[int, Looked | None]":
    """Samples of a window, and a close look at it if that can show anything."""
    quiet = expected.fits and _is_quiet(expected, window)
    return len(window.own.time), None if quiet else _look(expected, window)


def _is_quiet(expected: Expectation, window: Window) -> bool:
    """Whether nothing in a window comes near to standing out.

    Neither a mean nor a single sample; a spike and restless torque have some that are far off.
    """
    n, wide = length(expected.rate), window.wide
    left = expected.roughly_left(wide, max(1, n // _PLACES))
    mean, count = _mean(left, n)
    far = np.abs(mean) * np.sqrt(count / n) > _NEAR * STRONG * expected.scales(wide)
    rough = np.abs(left - mean) > _NEAR * ROUGH * expected.noise[:, None]
    return not (window.trimmed(far.T).any() or window.trimmed(rough.T).any())


def _look(expected: Expectation, window: Window) -> Looked:
    wide, n = window.wide, length(expected.rate)
    found = expected.compared(wide)
    flags, jump = spikes(found.left, expected)
    left = np.where(flags, np.nan, found.left)
    mean, count = _mean(left, n)
    with np.errstate(invalid="ignore"):
        size = mean * np.sqrt(count / n) / expected.scales(wide)
        rough = np.sqrt(np.maximum(_mean(left**2, n)[0] - mean**2, 0.0))
        rough /= (expected.noise * np.maximum(1.0, expected.misfit / NOISE))[:, None]
    if n < _ENOUGH:
        rough = np.zeros_like(rough)
    speeds, _ = joint_rates(expected.source.dynamics.kinematics, wide)
    signs = np.signbit(np.vstack([found.gear, speeds.T]))
    signs = np.diff(signs, axis=1, append=signs[:, -1:])
    taken = np.zeros_like(mean)
    if np.any(np.nan_to_num(np.abs(size)) > STRONG) or np.any(np.nan_to_num(rough) > ROUGH):
        taken = _taken_off(window, expected, mean)
    speed = np.abs(wide.qd.T) / expected.slack.speed[: len(mean), None]
    by_drive = (mean, size, rough, flags, jump, signs, taken, speed)
    own = (window.trimmed(x.T).T for x in by_drive)
    return Looked(window.own.time, window.own.z, *own)


def _taken_off(
    window: Window, expected: Expectation, mean: Float[np.ndarray, "dof wide"]
) -> Float[np.ndarray, "dof wide"]:
    """Torques of what the low-pass took off the motion, in the mean over the time of one.

    Where a robot starts, stops or turns sharply, the filtered motion does so smoothly, and earlier.
    """
    source, wide, n = expected.source, window.wide, length(expected.rate)
    rate = _slope(window.off, max(1, n // 4), expected.rate)
    rise = _slope(rate, max(1, n // 2), expected.rate)
    before = replace(wide, qd=wide.qd + rate, qdd=wide.qdd + rise)
    both = [source.torques(source.entries(w), expected.p) for w in (before, wide)]
    return np.where(np.isfinite(mean), both[0] - both[1], np.nan)


def _slope(x: Float[np.ndarray, "samples dof"], k: int, rate: float) -> np.ndarray:
    """Differences across k samples to either side, as a derivative; zero near the ends."""
    out = np.zeros_like(x)
    if len(x) > 2 * k:
        out[k:-k] = (x[2 * k :] - x[: -2 * k]) * (0.5 * rate / k)
    return out


def _mean(
    x: Float[np.ndarray, "dof samples"], n: int
) -> tuple[Float[np.ndarray, "dof samples"], Float[np.ndarray, "dof samples"]]:
    """Mean over the n samples about each one, without those that are NaN, and how many they are.

    NaN where the sample itself does not count.
    """
    good = np.isfinite(x)
    half = n // 2
    sums, counts = (
        np.cumsum(np.pad(y, ((0, 0), (half + 1, half))), axis=1)
        for y in (np.where(good, x, 0.0), good.astype(float))
    )
    total, count = sums[:, n:] - sums[:, :-n], counts[:, n:] - counts[:, :-n]
    return np.where(good, total / np.maximum(count, 1.0), np.nan), count
