"""Stretches of a recording whose torques stand out from what the motion asks for, in one pass.

The residual's mean over 9 ms is compared with its usual scatter: a stretch begins and ends where a
drive's is within 3 standard deviations, and counts if it is beyond 6 somewhere. Both are wider
where the scatter is no noise but a model that does not fit. Single samples that stand out are
spikes, and are looked for first (`spikes.py`). Windows overlap, so that their cuts do not show.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.identification.expectation import NOISE, Expectation, length
from deltaid.identification.expectation_blocks import deviation
from deltaid.identification.slack import joint_rates
from deltaid.identification.spikes import spikes
from deltaid.recording.masks.runs import runs_of
from deltaid.recording.windows import Window

# Where a stretch begins and ends, and what it must reach, in standard deviations.
_WEAK, _STRONG = 3.0, 6.0
# What a stretch of restless torque must reach, in standard deviations of single samples; and how
# many samples of a mean tell it.
_ROUGH, _ENOUGH = 12.0, 5
# Scatter so many times that of noise is no noise; thresholds are at most so many times wider.
_WIDEST = 3.0
# Of what does not fit, thresholds stay as they are where no more than this share of the stretches
# beyond them reaches only this part of them.
_FEW, _NEARLY = 0.5, 0.5
# A window is looked at closely where anything comes this near to standing out; to see that, torques
# are expected at so many places over the time of a mean.
_NEAR, _PLACES = 0.8, 2
# Time whose scatter is looked at together [s].
_TOGETHER = 4.0
# A step in time so many times the usual one ends a stretch.
_GAP = 1.5


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive samples that stand out.

    Attributes:
        start, end: when [s].
        drives: whose torques do.
        sizes: how far each drive's does at most, in units of the threshold that it had to reach.
        peak: when that was [s].
        z: task coordinates there.
        speed: of the drives there, as shares of their usual ones.
        left: residual torques there, mean over 9 ms [N m or N].
        spike: whether it is one of the samples and not of the mean.
        sharp: size of the torques of what the low-pass took off the motion there, as a share.
    """

    start: float
    end: float
    drives: tuple[int, ...]
    sizes: Float[np.ndarray, " dof"]
    peak: float
    z: Float[np.ndarray, " dof"]
    speed: Float[np.ndarray, " dof"]
    left: Float[np.ndarray, " dof"]
    spike: bool = False
    sharp: float = 0.0

    @property
    def size(self) -> float:
        """How far any drive's torque stands out."""
        return float(self.sizes.max())

    def with_next(self, one: "Stretch") -> "Stretch":
        """Both as one; the larger says what was at the peak."""
        larger = one if one.size > self.size else self
        drives = tuple(sorted({*self.drives, *one.drives}))
        return replace(larger, start=self.start, end=one.end, drives=drives)


@dataclass(frozen=True, eq=False)
class Outstanding:
    """What stands out of a recording, and when it might have for a reason in the drives.

    Attributes:
        stretches: in the order of time.
        duration: of all samples [s].
        looked: of those in windows that were looked at closely [s].
        turns: when in these the torque that a gear carries changes its sign, drive by drive [s].
        reversals: when a joint turns round, drives first, then passive joints with friction [s].
    """

    stretches: tuple[Stretch, ...]
    duration: float
    looked: float
    turns: tuple[Float[np.ndarray, " _"], ...]
    reversals: tuple[Float[np.ndarray, " _"], ...]


@dataclass(frozen=True, eq=False)
class _Looked:
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

    def part(self, which: slice) -> "_Looked":
        own = (x[:, which] for x in self.by_drive)
        return _Looked(self.time[which], self.z[which], *own)

    @property
    def by_drive(self) -> tuple[np.ndarray, ...]:
        """All but times and places."""
        first = (self.mean, self.size, self.rough, self.spikes, self.jump)
        return *first, self.signs, self.taken, self.speed


def outstanding(expected: Expectation) -> Outstanding:
    """What stands out of a recording, in one pass over it."""
    recording, kinematics = expected.source.recording, expected.source.dynamics.kinematics
    windows = recording.evaluate(kinematics, lambda window: _glance(expected, window))
    return _of(expected, windows)


def stands_out(expected: Expectation, window: Window) -> bool:
    """Whether anything stands out of a single window."""
    return bool(_of(expected, [_glance(expected, window)]).stretches)


def _glance(expected: Expectation, window: Window) -> "tuple[int, _Looked | None]":
    """Samples of a window, and a close look at it if that can show anything."""
    quiet = expected.fits and _is_quiet(expected, window)
    return len(window.own.time), None if quiet else _look(expected, window)


def _of(expected: Expectation, windows: "Iterable[tuple[int, _Looked | None]]") -> Outstanding:
    """What stands out of some windows."""
    step, samples, looked = 1.0 / expected.rate, 0, 0
    wider = np.clip(expected.misfit / NOISE, 1.0, _WIDEST)

    def close() -> Iterator[_Looked]:
        nonlocal samples
        for count, seen in windows:
            samples += count
            if seen is not None:
                yield seen

    narrow, wide = list[Stretch](), list[Stretch]()
    changes: list[list[np.ndarray]] = []
    for part in _together(close()):
        looked += len(part.time)
        changes.append([part.time[flags] for flags in part.signs])
        local = np.maximum(1.0, deviation(part.size))
        cuts = np.flatnonzero(np.diff(part.time) > _GAP * step) + 1
        for first, last in zip([0, *cuts], [*cuts, len(part.time)], strict=True):
            one = part.part(slice(first, last))
            _join(narrow, _stretches(one, local), step)
            if not expected.fits:
                _join(wide, _stretches(one, local * wider), step)
    shortest = step * (length(expected.rate) // 2 - 0.5)
    found = narrow if expected.fits or _apart(narrow) else wide
    kept = tuple(o for o in found if o.size >= 1.0 and (o.spike or o.end - o.start >= shortest))
    times = tuple(np.concatenate(one) for one in zip(*changes, strict=True))
    dof = len(wider)
    return Outstanding(kept, samples * step, looked * step, times[:dof], times[dof:])


def _apart(stretches: Iterable[Stretch]) -> bool:
    """Whether what stands out is set apart from all the rest, by few that nearly do."""
    sizes = np.array([one.size for one in stretches if not one.spike])
    nearly = int(np.sum((sizes >= _NEARLY) & (sizes < 1.0)))
    return nearly <= _FEW * int(np.sum(sizes >= 1.0))


def _is_quiet(expected: Expectation, window: Window) -> bool:
    """Whether nothing in a window comes near to standing out.

    Neither a mean nor a single sample; a spike and restless torque have some that are far off.
    """
    n, wide = length(expected.rate), window.wide
    left = expected.roughly_left(wide, max(1, n // _PLACES))
    mean, count = _mean(left, n)
    far = np.abs(mean) * np.sqrt(count / n) > _NEAR * _STRONG * expected.scales(wide)
    rough = np.abs(left - mean) > _NEAR * _ROUGH * expected.noise[:, None]
    return not (window.trimmed(far.T).any() or window.trimmed(rough.T).any())


def _look(expected: Expectation, window: Window) -> _Looked:
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
    if np.any(np.nan_to_num(np.abs(size)) > _STRONG) or np.any(np.nan_to_num(rough) > _ROUGH):
        taken = _taken_off(window, expected, mean)
    speed = np.abs(wide.qd.T) / expected.slack.speed[: len(mean), None]
    by_drive = (mean, size, rough, flags, jump, signs, taken, speed)
    own = (window.trimmed(x.T).T for x in by_drive)
    return _Looked(window.own.time, window.own.z, *own)


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


def _together(windows: Iterable[_Looked]) -> Iterator[_Looked]:
    """Windows in groups of some seconds; a short rest belongs to the last."""
    ready: list[_Looked] = []
    waiting: list[_Looked] = []
    for one in windows:
        if not len(one.time):
            continue
        waiting.append(one)
        if waiting[-1].time[-1] - waiting[0].time[0] >= _TOGETHER:
            if ready:
                yield _joined(ready)
            ready, waiting = waiting, []
    if ready or waiting:
        yield _joined([*ready, *waiting])


def _joined(parts: list[_Looked]) -> _Looked:
    by_drive = zip(*(w.by_drive for w in parts), strict=True)
    return _Looked(
        np.concatenate([w.time for w in parts]),
        np.concatenate([w.z for w in parts]),
        *(np.concatenate(own, axis=1) for own in by_drive),
    )


def _stretches(w: _Looked, limits: Float[np.ndarray, " dof"]) -> list[Stretch]:
    """Runs of samples without a gap in which any drive is beyond the weak threshold."""
    lasting = np.nan_to_num(np.abs(w.size)) / (_STRONG * limits[:, None])
    size = np.maximum(lasting, np.nan_to_num(w.rough) / _ROUGH)
    found: list[Stretch] = []
    weak = np.asarray(np.any(size > _WEAK / _STRONG, axis=0))
    for first, last in runs_of(weak).tolist():
        inside = slice(first, last + 1)
        largest = size[:, inside].max(axis=1)
        if largest.max() < _NEARLY and first > 0 and last < len(w.time) - 1:
            continue  # nor does it go on in the next window
        at = first + int(np.argmax(np.sum(lasting[:, inside] ** 2, axis=0)))
        which = tuple(np.flatnonzero(largest > _WEAK / _STRONG).tolist())
        one = _stretch(w, (first, at, last), which, largest, w.mean[:, at])
        found.append(replace(one, sharp=_share(w.taken[:, inside], w.mean[:, inside])))
    for i in range(len(size)):
        for first, last in runs_of(w.spikes[i]).tolist():
            at = first + int(np.argmax(w.jump[i, first : last + 1]))
            left = np.zeros(len(size))
            left[i] = w.jump[i, at]
            sizes = np.where(left > 0, np.inf, 0.0)
            found.append(replace(_stretch(w, (first, at, last), (i,), sizes, left), spike=True))
    return sorted(found, key=lambda one: one.start)


def _share(
    part: Float[np.ndarray, "dof samples"], whole: Float[np.ndarray, "dof samples"]
) -> float:
    """Size of one residual as a share of another's."""
    return float(
        np.linalg.norm(np.nan_to_num(part)) / max(np.linalg.norm(np.nan_to_num(whole)), 1e-300)
    )


def _stretch(
    w: _Looked,
    at: tuple[int, int, int],
    drives: tuple[int, ...],
    sizes: Float[np.ndarray, " dof"],
    left: Float[np.ndarray, " dof"],
) -> Stretch:
    """A stretch from its first sample, that of the peak, and its last."""
    start, peak, end = (float(w.time[k]) for k in at)
    z, speed = w.z[at[1]], w.speed[:, at[1]]
    return Stretch(start, end, drives, sizes, peak, z, speed, np.nan_to_num(left))


def _join(found: list[Stretch], more: list[Stretch], step: float) -> None:
    """Add stretches of consecutive samples; the first may go on where the last one ended."""
    for one in more:
        last = found[-1] if found else None
        if last is None or last.spike or one.spike or one.start - last.end > _GAP * step:
            found.append(one)
        else:
            found[-1] = last.with_next(one)
