"""Stretches of a recording whose torques are outliers against a fit, in one pass.

A stretch begins and ends where a drive's mean residual is within 3 standard deviations, and counts
if it is beyond 6 somewhere (`inspected_window.py`). Both are wider where the scatter is no noise
but a model that does not fit.

Outliers may recur for a reason in a drive (`without_recurring`). Friction that the description has
no law for causes them where a joint turns round, play where the torque that a gear carries changes
its sign. There a motor runs ahead through its play, and all drives' torques follow from another
motion, whether they are outliers or not.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import bdtrc

from deltaid.estimation.traces import GAP
from deltaid.identification.expectation import NOISE, Expectation, deviation
from deltaid.identification.inspected_window import (
    ROUGH,
    InspectedWindow,
    inspected_window,
    together,
)
from deltaid.levels import NEVER, STRONG, SURE, UNLIKELY
from deltaid.recording.filter import LowPass
from deltaid.recording.masks.masks import runs_of
from deltaid.recording.repairs import BACKLASH, SPIKE, LeftSpan
from deltaid.recording.windows import Window

# Where scatter is no noise, thresholds are at most so many times wider.
_WIDEST = 3.0
# Of what does not fit, thresholds stay as they are where no more than half of the stretches beyond
# them reaches only this part of them.
_NEARLY = 0.5
# A stretch belongs to a change of sign within so much time [s] and this share of the low-pass's
# period; so many must for a drive, half of its stretches, hardly by chance.
_NEAR, _PERIOD, _FEWEST = 6e-3, 0.6, 8
# Where one gear has play, fewer are enough for another. All drives share its effect on the motion,
# up to so many times as far from a change of sign.
_AS_WELL, _ABOUT = 4, 2.0
# One that is so many times as large as those of play usually are is more than play; elsewhere one
# that is larger than this, since torques also come near zero without a change of sign.
_LARGER, _ELSEWHERE = 4.0, 1.5

OfDrives = Float[np.ndarray, " dof"]
Times = Float[np.ndarray, " _"]


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
        return float(self.sizes.max())


@dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers of a recording, and when drives might have caused them."""

    stretches: tuple[OutlierStretch, ...]  # in the order of time
    spikes: tuple[LeftSpan, ...]  # single samples of a drive
    inspected: float  # duration of the recording's windows [s]
    # when the torque that a gear carries changes its sign, drive by drive [s]
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
    recording, kinematics = expected.source.recording, expected.source.dynamics.kinematics
    return _outliers(
        expected, recording.evaluate(kinematics, lambda w: inspected_window(expected, w))
    )


def has_outliers(expected: Expectation, window: Window) -> bool:
    return not _outliers(expected, [inspected_window(expected, window)]).is_empty


def _outliers(expected: Expectation, windows: Iterable[InspectedWindow]) -> Outliers:
    step, inspected = 1.0 / expected.rate, 0
    wider = np.clip(expected.misfit / NOISE, 1.0, _WIDEST)
    narrow, wide = JoinedStretches(GAP * step), JoinedStretches(GAP * step)
    changes, spikes = list[list[np.ndarray]](), list[LeftSpan]()
    for part in together(w for w in windows if len(w.time)):
        inspected += len(part.time)
        changes.append([part.time[flags] for flags in part.signs])
        local = np.maximum(1.0, deviation(part.size))
        cuts = np.flatnonzero(np.diff(part.time) > GAP * step) + 1
        for first, last in zip([0, *cuts], [*cuts, len(part.time)], strict=True):
            run = part.part(slice(first, last))
            spikes += [
                LeftSpan(float(start) - step, float(end) + step, SPIKE, (drive,))
                for drive, flags in enumerate(run.spikes)
                for start, end in run.time[runs_of(flags)]
            ]
            narrow.join(_stretches(run, local))
            if not expected.fits:
                wide.join(_stretches(run, local * wider))
    narrow.end()
    wide.end()
    apart = narrow.nearly <= 0.5 * len(narrow.reaching)
    course = narrow if expected.fits or apart else wide
    shortest = step * (expected.length // 2 - 0.5)
    kept = tuple(stretch for stretch in course.reaching if stretch.end - stretch.start >= shortest)
    times = tuple(np.concatenate(parts) for parts in zip(*changes, strict=True))
    dof = len(wider)
    return Outliers(kept, tuple(spikes), inspected * step, times[:dof], times[dof:])


def _stretches(w: InspectedWindow, limits: OfDrives) -> list[OutlierStretch]:
    """Runs of samples without a gap in which any drive is beyond the weak threshold."""
    lasting = np.nan_to_num(np.abs(w.size)) / (STRONG * limits[:, None])
    size = np.maximum(lasting, np.nan_to_num(w.rough) / ROUGH)
    taken, mean = np.nan_to_num(w.taken), np.nan_to_num(w.mean)
    stretches = list[OutlierStretch]()
    for first, last in runs_of(np.any(size > SURE / STRONG, axis=0)).tolist():
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
    spans = [
        LeftSpan(start - margin, end + margin, BACKLASH, gear=gear) for start, end, gear in spoilt
    ]
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
    often = hits >= max(_FEWEST, 0.5 * len(peaks))
    return often and chance < NEVER, hits >= _AS_WELL and chance < UNLIKELY
