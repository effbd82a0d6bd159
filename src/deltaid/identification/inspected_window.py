"""Quantities of a window's samples that outliers are searched in: means, roughness, spikes, signs.

The residual's mean over 9 ms is compared with its usual scatter. Spikes, single outliers, are
excluded first. Windows overlap, so that outliers at their ends are complete.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.identification.expectation import NOISE, Expectation
from deltaid.identification.expectation_source import Torques, joint_rates
from deltaid.levels import STRONG
from deltaid.recording.windows import Window

# Threshold of rough torque and of spikes, in standard deviations of single samples.
ROUGH = 12.0
# Fewest samples of a mean by which torque can be rough.
_ENOUGH = 5
# Longest spike [samples]; longest spike of several drives at once [s].
_LONGEST, _AT_ONCE = 3, 3e-3
# Samples on either side of a spike, and by how many times it exceeds their range.
_BESIDE, _STEEP = 4, 3.0
# Time over which scatter is evaluated [s].
_TOGETHER = 4.0


@dataclass(frozen=True, eq=False)
class InspectedWindow:
    """A window's inner samples, one a column."""

    time: Float[np.ndarray, " samples"]
    z: Torques  # task coordinates
    mean: Torques  # of the residual over 9 ms [N m or N]
    size: Torques  # the same in standard deviations
    rough: Torques  # scatter of the residual over 9 ms, in standard deviations of single samples
    spikes: Bool[np.ndarray, "dof samples"]
    # whether torques of gears change their sign, then whether speeds of joints do
    signs: Bool[np.ndarray, "changes samples"]
    removed: Torques  # of the motion that the low-pass removed [N m or N]
    speed: Torques  # of the drives, as shares of the usual ones

    def part(self, samples: slice) -> "InspectedWindow":
        return InspectedWindow(*(getattr(self, item.name)[..., samples] for item in fields(self)))

    @classmethod
    def joined(cls, windows: Sequence["InspectedWindow"]) -> "InspectedWindow":
        parts = ([getattr(w, item.name) for w in windows] for item in fields(cls))
        return cls(*(np.concatenate(part, axis=-1) for part in parts))


def inspected_window(expected: Expectation, window: Window) -> InspectedWindow:
    wide, n = window.wide, expected.length
    residual, gear = expected.compared(wide)
    spikes = _spikes(residual, expected)
    residual = np.where(spikes, np.nan, residual)
    mean, count = _mean(residual, n)
    with np.errstate(invalid="ignore"):
        size = mean * np.sqrt(count / n) / expected.scales(wide)
        rough = np.sqrt(np.maximum(_mean(residual**2, n)[0] - mean**2, 0.0))
        rough /= (expected.noise * np.maximum(1.0, expected.misfit / NOISE))[:, None]
    if n < _ENOUGH:
        rough = np.zeros_like(rough)
    speeds, _ = joint_rates(expected.source.dynamics.kinematics, wide)
    signs = np.signbit(np.vstack([gear, speeds.T]))
    signs = np.diff(signs, axis=1, append=signs[:, -1:])
    removed = np.zeros_like(mean)
    if np.any(np.nan_to_num(np.abs(size)) > STRONG) or np.any(np.nan_to_num(rough) > ROUGH):
        removed = _removed_torques(window, expected, mean)
    speed = np.abs(wide.qd.T) / expected.nuisance.speed[: len(mean), None]
    by_drive = (wide.z.T, mean, size, rough, spikes, signs, removed, speed)
    return InspectedWindow(window.inner.time, *(window.trimmed(values.T).T for values in by_drive))


def _removed_torques(window: Window, expected: Expectation, mean: Torques) -> Torques:
    """Torques of the motion that the low-pass removed, as at jolts: where a robot starts, stops or
    turns sharply, the filtered motion does so smoothly and earlier."""
    source, wide, n = expected.source, window.wide, expected.length
    rate = _slope(window.off, max(1, n // 4), expected.rate)
    rise = _slope(rate, max(1, n // 2), expected.rate)
    before = replace(wide, qd=wide.qd + rate, qdd=wide.qdd + rise)
    torques = [source.torques(source.entries(w), expected.p) for w in (before, wide)]
    return np.where(np.isfinite(mean), torques[0] - torques[1], np.nan)


def _slope(values: Float[np.ndarray, "samples dof"], k: int, rate: float) -> np.ndarray:
    """Derivative by differences across k samples to either side; zero near the ends."""
    out = np.zeros_like(values)
    if len(values) > 2 * k:
        out[k:-k] = (values[2 * k :] - values[: -2 * k]) * (0.5 * rate / k)
    return out


def _mean(values: Torques, n: int) -> tuple[Torques, Torques]:
    """Mean over the n samples about each one without NaN, and their number.

    NaN where the sample itself does not count.
    """
    good, half = np.isfinite(values), n // 2
    sums = np.cumsum(
        np.pad([np.where(good, values, 0.0), good], ((0, 0), (0, 0), (half + 1, half))), axis=2
    )
    total, count = sums[..., n:] - sums[..., :-n]
    return np.where(good, total / np.maximum(count, 1.0), np.nan), count


def _spikes(residual: Torques, expected: Expectation) -> Bool[np.ndarray, "dof samples"]:
    """One to three samples far from both sides; both edges must be far steeper than the residual
    before and after, unlike those at the top of a hump."""
    (dof, samples), flags = residual.shape, np.zeros(residual.shape, dtype=bool)
    limit, far = ROUGH * expected.noise[:, None], _LONGEST + 1
    apart = np.abs(residual[:, far:] - residual[:, :-far]) > limit
    if not np.any(apart[:, :-far] & apart[:, far:]):  # as nearly always
        return flags
    brief = 1 if dof == 1 else _LONGEST
    for rows in range(1, _LONGEST + 1):
        if samples < rows + 2 * _BESIDE:
            continue
        x = np.lib.stride_tricks.sliding_window_view(residual, rows + 2 * _BESIDE, axis=1)
        before, inside, after = x[..., :_BESIDE], x[..., _BESIDE:-_BESIDE], x[..., -_BESIDE:]
        up, down = inside - before[..., -1:], inside - after[..., :1]
        same = np.all(np.sign(up) == np.sign(up[..., :1]), axis=-1) & np.all(up * down > 0, axis=-1)
        size = np.where(same, np.minimum(np.abs(up), np.abs(down)).min(axis=-1), 0.0)
        around = np.maximum(np.ptp(before, axis=-1), np.ptp(after, axis=-1))
        quiet = np.sum(size > 0.5 * limit, axis=0) == 1
        at_once = rows <= _AT_ONCE * expected.rate
        detected = (size > limit) & (size > _STEEP * around) & (at_once | ((rows <= brief) & quiet))
        for i, k in np.argwhere(detected):
            flags[i, k + _BESIDE : k + _BESIDE + rows] = True
    return flags


def together(windows: Iterable[InspectedWindow]) -> Iterator[InspectedWindow]:
    """Windows joined to groups of some seconds; a short rest belongs to the last group."""
    ready, waiting = list[InspectedWindow](), list[InspectedWindow]()
    for window in windows:
        waiting.append(window)
        if window.time[-1] - waiting[0].time[0] >= _TOGETHER:
            if ready:
                yield InspectedWindow.joined(ready)
            ready, waiting = waiting, []
    if ready or waiting:
        yield InspectedWindow.joined([*ready, *waiting])
