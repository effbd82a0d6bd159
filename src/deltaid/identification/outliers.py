"""Stretches of a recording whose torques are outliers against a fit, in one pass.

The residual's mean over 9 ms is compared with its usual scatter: a stretch begins and ends where a
drive's is within 3 standard deviations, and counts if it is beyond 6 somewhere. Both are wider
where the scatter is no noise but a model that does not fit. Single outliers are spikes, and are
searched first. Windows overlap, so that their cuts do not show.

Outliers may recur for a reason in a drive (`without_recurring`). Friction that the description has
no law for causes them where a joint turns round, play where the torque that a gear carries changes
its sign. There a motor runs ahead through its play, and all drives' torques follow from another
motion, whether they are outliers or not.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from deltaid.identification.expectation import NOISE, Expectation, deviation
from deltaid.identification.expectation_source import Torques, joint_rates
from deltaid.recording.filter import LowPass
from deltaid.recording.masks.masks import runs_of
from deltaid.recording.repairs import BACKLASH, SPIKE, LeftSpan
from deltaid.recording.windows import Window

# Thresholds of outliers in standard deviations; and of restless torque, in those of single samples.
_STRONG, _ROUGH = 6.0, 12.0
# Samples of a mean that restless torque needs.
_ENOUGH = 5
# A window is inspected where anything reaches this share of a threshold; for that, torques are
# expected at so many places over the time of a mean.
_REACHED, _PLACES = 0.8, 2
# A spike exceeds so many standard deviations of single samples, for so many at most; several drives
# at once have one only where it is over in less than this [s].
_SPIKE, _LONGEST, _AT_ONCE = 12.0, 3, 3e-3
# Samples on either side of a spike, whose range it exceeds so many times.
_BESIDE, _STEEP = 4, 3.0
# Where a stretch begins and ends, in standard deviations.
_WEAK = 3.0
# Where scatter is no noise, thresholds are at most so many times wider.
_WIDEST = 3.0
# Of what does not fit, thresholds stay as they are where no more than this share of the stretches
# beyond them reaches only this part of them.
_FEW, _NEARLY = 0.5, 0.5
# Time whose scatter is evaluated together [s].
_TOGETHER = 4.0
# A step in time so many times the usual one ends a stretch.
_GAP = 1.5
# A stretch belongs to a change of sign within so much time [s] and this share of the low-pass's
# period; so many must for a drive, this share of its stretches, by chance this unlikely.
_NEAR, _PERIOD, _FEWEST, _OFTEN, _CHANCE = 6e-3, 0.6, 8, 0.5, 1e-6
# Where one gear has play, fewer are enough for another: so many, by chance this unlikely. All
# drives share its effect on the motion, up to so many times as far from a change of sign.
_AS_WELL, _UNLIKELY, _ABOUT = 4, 1e-2, 2.0
# One that is so many times as large as those of play usually are is more than play; elsewhere one
# that is larger than this, since torques also come near zero without a change of sign.
_LARGER, _ELSEWHERE = 4.0, 1.5

OfDrives = Float[np.ndarray, " dof"]
Times = Float[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class InspectedWindow:
    """A window's own samples, one a column."""

    time: Float[np.ndarray, " samples"]
    z: Torques  # task coordinates
    mean: Torques  # of the residual over 9 ms [N m or N]
    size: Torques  # the same in standard deviations
    rough: Torques  # how restless the torque is, in standard deviations of single samples
    spikes: Bool[np.ndarray, "dof samples"]
    # where gears' torques change their sign, then where joints' speeds do
    signs: Bool[np.ndarray, "changes samples"]
    taken: Torques  # of what the low-pass took off the motion [N m or N]
    speed: Torques  # of the drives, as shares of their usual ones

    def part(self, samples: slice) -> "InspectedWindow":
        return InspectedWindow(*(getattr(self, item.name)[..., samples] for item in fields(self)))

    @classmethod
    def joined(cls, windows: Sequence["InspectedWindow"]) -> "InspectedWindow":
        parts = ([getattr(w, item.name) for w in windows] for item in fields(cls))
        return cls(*(np.concatenate(part, axis=-1) for part in parts))


def _glance(expected: Expectation, window: Window) -> InspectedWindow | None:
    """A window inspected, if it may have outliers: a mean or a single sample near a threshold."""
    n, wide = expected.length, window.wide
    if expected.fits:
        residual = expected.rough_residual(wide, max(1, n // _PLACES))
        mean, count = _mean(residual, n)
        far = np.abs(mean) * np.sqrt(count / n) > _REACHED * _STRONG * expected.scales(wide)
        rough = np.abs(residual - mean) > _REACHED * _ROUGH * expected.noise[:, None]
        if not window.trimmed((far | rough).T).any():
            return None
    return _look(expected, window)


def _look(expected: Expectation, window: Window) -> InspectedWindow:
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
    taken = np.zeros_like(mean)
    if np.any(np.nan_to_num(np.abs(size)) > _STRONG) or np.any(np.nan_to_num(rough) > _ROUGH):
        taken = _taken_off(window, expected, mean)
    speed = np.abs(wide.qd.T) / expected.nuisance.speed[: len(mean), None]
    by_drive = (wide.z.T, mean, size, rough, spikes, signs, taken, speed)
    return InspectedWindow(window.own.time, *(window.trimmed(values.T).T for values in by_drive))


def _taken_off(window: Window, expected: Expectation, mean: Torques) -> Torques:
    """Torques of what the low-pass took off the motion, in the mean over the time of one.

    Where a robot starts, stops or turns sharply, the filtered motion does so smoothly, and earlier.
    """
    source, wide, n = expected.source, window.wide, expected.length
    rate = _slope(window.off, max(1, n // 4), expected.rate)
    rise = _slope(rate, max(1, n // 2), expected.rate)
    before = replace(wide, qd=wide.qd + rate, qdd=wide.qdd + rise)
    torques = [source.torques(source.entries(w), expected.p) for w in (before, wide)]
    return np.where(np.isfinite(mean), torques[0] - torques[1], np.nan)


def _slope(values: Float[np.ndarray, "samples dof"], k: int, rate: float) -> np.ndarray:
    """Differences across k samples to either side, as a derivative; zero near the ends."""
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
    """Single samples, or two or three, far above both sides.

    Both edges must be far steeper than what goes before and after, or the top of a hump would do.
    """
    (dof, samples), flags = residual.shape, np.zeros(residual.shape, dtype=bool)
    limit, far = _SPIKE * expected.noise[:, None], _LONGEST + 1
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


@dataclass(frozen=True, eq=False)
class OutlierStretch:
    """Consecutive samples that are outliers."""

    start: float  # when [s]
    end: float
    # how far each drive's does at most, in units of the threshold that it had to reach
    sizes: OfDrives
    peak: float  # when that was [s]
    z: OfDrives  # task coordinates there
    speed: OfDrives  # of the drives there, as shares of their usual ones
    left: OfDrives  # residual torques there, mean over 9 ms [N m or N]
    # size of the torques of what the low-pass took off the motion there, as a share
    sharp: float

    @property
    def size(self) -> float:
        """The largest of the drives' sizes."""
        return float(self.sizes.max())


@dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers of a recording, and when drives might have caused them."""

    stretches: tuple[OutlierStretch, ...]  # in the order of time
    spikes: tuple[LeftSpan, ...]  # single samples of a drive
    inspected: float  # duration of the inspected windows [s]
    # when in these the torque that a gear carries changes its sign, drive by drive [s]
    turns: tuple[Times, ...]
    # when a joint turns round, drives first, then passive joints with friction [s]
    reversals: tuple[Times, ...]

    @property
    def is_empty(self) -> bool:
        return not (self.stretches or self.spikes)


@dataclass
class JoinedStretches:
    """Stretches along a recording, those no more than `gap` [s] apart as one.

    Of those that fall short of the threshold no more is kept than the number that nearly reach it.
    """

    gap: float
    reaching: list[OutlierStretch] = field(default_factory=list[OutlierStretch])
    nearly: int = 0

    def join(self, stretches: Iterable[OutlierStretch]) -> None:
        """Add stretches; the first may go on where the last one ended."""
        for stretch in stretches:
            if self.reaching and stretch.start - (last := self.reaching[-1]).end <= self.gap:
                larger = stretch if stretch.size > last.size else last
                self.reaching[-1] = replace(larger, start=last.start, end=stretch.end)
            else:
                self.end()
                self.reaching.append(stretch)

    def end(self) -> None:
        """End the last one, and drop it if it falls short: noise has many like it."""
        if self.reaching and self.reaching[-1].size < 1.0:
            self.nearly += self.reaching.pop().size >= _NEARLY


def detected_outliers(expected: Expectation) -> Outliers:
    """Outliers of a recording, in one pass over it."""
    recording, kinematics = expected.source.recording, expected.source.dynamics.kinematics
    return _outliers(expected, recording.evaluate(kinematics, lambda w: _glance(expected, w)))


def has_outliers(expected: Expectation, window: Window) -> bool:
    return not _outliers(expected, [_glance(expected, window)]).is_empty


def _outliers(expected: Expectation, windows: Iterable[InspectedWindow | None]) -> Outliers:
    step, inspected = 1.0 / expected.rate, 0
    wider = np.clip(expected.misfit / NOISE, 1.0, _WIDEST)
    narrow, wide = JoinedStretches(_GAP * step), JoinedStretches(_GAP * step)
    changes, spikes = list[list[np.ndarray]](), list[LeftSpan]()
    for part in _together(w for w in windows if w is not None and len(w.time)):
        inspected += len(part.time)
        changes.append([part.time[flags] for flags in part.signs])
        local = np.maximum(1.0, deviation(part.size))
        cuts = np.flatnonzero(np.diff(part.time) > _GAP * step) + 1
        for first, last in zip([0, *cuts], [*cuts, len(part.time)], strict=True):
            run = part.part(slice(first, last))
            spikes += [
                LeftSpan(float(run.time[a]) - step, float(run.time[b]) + step, SPIKE, (drive,))
                for drive, flags in enumerate(run.spikes)
                for a, b in runs_of(flags)
            ]
            narrow.join(_stretches(run, local))
            if not expected.fits:
                wide.join(_stretches(run, local * wider))
    narrow.end()
    wide.end()
    apart = narrow.nearly <= _FEW * len(narrow.reaching)
    course = narrow if expected.fits or apart else wide
    shortest = step * (expected.length // 2 - 0.5)
    kept = tuple(stretch for stretch in course.reaching if stretch.end - stretch.start >= shortest)
    times = tuple(np.concatenate(parts) for parts in zip(*changes, strict=True))
    dof = len(wider)
    return Outliers(kept, tuple(spikes), inspected * step, times[:dof], times[dof:])


def _together(windows: Iterable[InspectedWindow]) -> Iterator[InspectedWindow]:
    """Windows in groups of some seconds; a short rest belongs to the last."""
    ready, waiting = list[InspectedWindow](), list[InspectedWindow]()
    for window in windows:
        waiting.append(window)
        if window.time[-1] - waiting[0].time[0] >= _TOGETHER:
            if ready:
                yield InspectedWindow.joined(ready)
            ready, waiting = waiting, []
    if ready or waiting:
        yield InspectedWindow.joined([*ready, *waiting])


def _stretches(w: InspectedWindow, limits: OfDrives) -> list[OutlierStretch]:
    """Runs of samples without a gap in which any drive is beyond the weak threshold."""
    lasting = np.nan_to_num(np.abs(w.size)) / (_STRONG * limits[:, None])
    size = np.maximum(lasting, np.nan_to_num(w.rough) / _ROUGH)
    taken, mean = np.nan_to_num(w.taken), np.nan_to_num(w.mean)
    stretches = list[OutlierStretch]()
    for first, last in runs_of(np.any(size > _WEAK / _STRONG, axis=0)).tolist():
        inside = slice(first, last + 1)
        sizes = size[:, inside].max(axis=1)
        if sizes.max() < _NEARLY and first > 0 and last < len(w.time) - 1:
            continue  # nor does it go on in the next window
        k = first + int(np.argmax(np.sum(lasting[:, inside] ** 2, axis=0)))
        start, peak, end = w.time[[first, k, last]].tolist()
        # Copies: a view would keep all samples about it, for as long as the recording is inspected.
        z, speed, residual = (values[:, k].copy() for values in (w.z, w.speed, mean))
        total = max(float(np.linalg.norm(mean[:, inside])), 1e-300)
        sharp = float(np.linalg.norm(taken[:, inside])) / total
        stretches.append(OutlierStretch(start, end, sizes, peak, z, speed, residual, sharp))
    return stretches


def without_recurring(
    outliers: Outliers,
    stretches: Sequence[OutlierStretch],
    low_pass: LowPass,
    margin: float,
) -> tuple[list[OutlierStretch], list[LeftSpan]]:
    """Those of some stretches that have no reason in a drive, and all that play spoils.

    Args:
        outliers: what the stretches are of.
        margin: time about a change of sign, and about outliers there [s].
    """
    near, turns = _NEAR + _PERIOD / low_pass.motion_cutoff, outliers.turns
    peaks = np.array([stretch.peak for stretch in stretches])
    first = np.array([np.argmax(stretch.sizes) for stretch in stretches], dtype=int)
    size = np.array([stretch.size for stretch in stretches])
    friction, play = np.zeros((2, len(stretches)), dtype=bool)
    for j, times in enumerate(outliers.reversals):
        of_joint = (first == j) | (j >= len(turns))
        if _recurs(peaks[of_joint], times, near, outliers.inspected)[0]:
            friction |= of_joint & _beside(peaks, times, near)
    of_drives = [(first == i) & ~friction for i in range(len(turns))]
    rules = [
        _recurs(peaks[of_drive], times, near, outliers.inspected)
        for of_drive, times in zip(of_drives, turns, strict=True)
    ]
    spoilt: list[tuple[float, float, int]] = []
    if any(rule for rule, _ in rules):
        loose = [i for i, (_, as_well) in enumerate(rules) if as_well]
        usual = [of_drives[i] & _beside(peaks, turns[i], near) for i in loose]
        about = [_beside(peaks, times, _ABOUT * near) for times in turns]
        most = np.where(np.any(about, axis=0), _LARGER, _ELSEWHERE)
        play = ~friction & (size <= most * np.median(size[np.any(usual, axis=0)]))
        spoilt = [(t, t, i) for i in loose for t in turns[i].tolist()]
        for k in np.flatnonzero(play).tolist():
            gear = min(loose, key=lambda i: np.min(np.abs(turns[i] - peaks[k])))
            spoilt.append((stretches[k].start, stretches[k].end, gear))
    spans = [LeftSpan(a - margin, b + margin, BACKLASH, gear=gear) for a, b, gear in spoilt]
    rest = ~(friction | play)
    return [stretch for stretch, kept in zip(stretches, rest, strict=True) if kept], spans


def _beside(peaks: Times, times: Times, near: float) -> Bool[np.ndarray, " _"]:
    """Which peaks are near one of some ascending times."""
    after = np.append(times, np.inf)[np.searchsorted(times, peaks)]
    before = np.append(-np.inf, times)[np.searchsorted(times, peaks)]
    return np.minimum(after - peaks, peaks - before) <= near


def _recurs(peaks: Times, times: Times, near: float, duration: float) -> tuple[bool, bool]:
    """Whether peaks near some times are the rule; whether they may be, as for another drive."""
    if not len(peaks) or not len(times):
        return False, False
    gaps = np.minimum(np.diff(times), 2 * near)
    share = min(1.0, (gaps.sum() + 2 * near) / duration)
    hits = int(_beside(peaks, times, near).sum())
    chance = float(bdtrc(hits - 1, len(peaks), share))  # of so many or more
    often = hits >= max(_FEWEST, _OFTEN * len(peaks))
    return often and chance < _CHANCE, hits >= _AS_WELL and chance < _UNLIKELY
