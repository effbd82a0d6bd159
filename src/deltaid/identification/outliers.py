"""Stretches of a recording whose torques are outliers against a fit, in one pass.

A stretch begins and ends where a drive's mean residual is within 3 standard deviations, and counts
if it exceeds 6 somewhere (`inspected_window.py`). Both thresholds are wider where scatter comes
from a model that does not fit.

Outliers may recur because of a drive (`without_recurring`): missing friction terms cause them where
a joint turns round, play where the torque of a gear changes its sign. There the motor runs ahead
through the play, and the motion that all drives' torques are computed from is wrong.
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

# Largest factor by which thresholds are widened for a model that does not fit.
_WIDEST = 3.0
# Share of the threshold from which a stretch nearly reaches it. Thresholds are not widened if at
# most half as many stretches nearly reach them as reach them.
_NEARLY = 0.5
# A stretch belongs to a change of sign within this time [s] plus this share of the low-pass's
# period; the least number of such stretches of a drive that has play.
_NEAR, _PERIOD, _FEWEST = 6e-3, 0.6, 8
# The same number where another gear has play; and the multiple of that time within which play of
# one gear affects the other drives.
_AS_WELL, _ABOUT = 4, 2.0
# Largest size of a stretch of play over the usual one, near a change of sign and elsewhere, where
# torques come near zero without a change.
_LARGER, _ELSEWHERE = 4.0, 1.5

OfDrives = Float[np.ndarray, " dof"]
Times = Float[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class OutlierStretch:
    """Consecutive samples that are outliers."""

    start: float  # when [s]
    end: float
    sizes: OfDrives  # largest residual of each drive, in units of the threshold
    peak: float  # time of the largest [s]
    z: OfDrives  # task coordinates there
    speed: OfDrives  # of the drives there, as shares of their usual ones
    left: OfDrives  # residual torques there, mean over 9 ms [N m or N]
    sharp: float  # torques of the motion that the low-pass removed, as a share of the residual

    @property
    def size(self) -> float:
        return float(self.sizes.max())


@dataclass(frozen=True, eq=False)
class Outliers:
    """Outliers of a recording, and times at which drives may have caused them."""

    stretches: tuple[OutlierStretch, ...]  # in the order of time
    spikes: tuple[LeftSpan, ...]  # single samples of a drive
    inspected: float  # duration of the recording's windows [s]
    turns: tuple[Times, ...]  # changes of sign of the torque of each drive's gear [s]
    # reversals of joints, drives first, then passive joints with friction [s]
    reversals: tuple[Times, ...]


@dataclass
class JoinedStretches:
    """Stretches along a recording, joined where they are at most `gap` [s] apart.

    Only the number of stretches below the threshold that nearly reach it is kept.
    """

    gap: float
    reaching: list[OutlierStretch] = field(default_factory=list[OutlierStretch])
    nearly: int = 0

    def join(self, stretches: Iterable[OutlierStretch]) -> None:
        """Add stretches; the first may continue the last one."""
        for stretch in stretches:
            if self.reaching and stretch.start - (last := self.reaching[-1]).end <= self.gap:
                larger = stretch if stretch.size > last.size else last
                self.reaching[-1] = replace(larger, start=last.start, end=stretch.end)
            else:
                self.end()
                self.reaching.append(stretch)

    def end(self) -> None:
        """End the last stretch, and drop it below the threshold: noise has many like it."""
        if self.reaching and self.reaching[-1].size < 1.0:
            self.nearly += self.reaching.pop().size >= _NEARLY


def detected_outliers(expected: Expectation) -> Outliers:
    recording, kinematics = expected.source.recording, expected.source.dynamics.kinematics
    return _outliers(
        expected, recording.evaluate(kinematics, lambda w: inspected_window(expected, w))
    )


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
    removed, mean = np.nan_to_num(w.removed), np.nan_to_num(w.mean)
    stretches = list[OutlierStretch]()
    for first, last in runs_of(np.any(size > SURE / STRONG, axis=0)).tolist():
        inside = slice(first, last + 1)
        sizes = size[:, inside].max(axis=1)
        if sizes.max() < _NEARLY and first > 0 and last < len(w.time) - 1:
            continue  # it ends within this window
        k = first + int(np.argmax(np.sum(lasting[:, inside] ** 2, axis=0)))
        start, peak, end = w.time[[first, k, last]].tolist()
        # Copies: a view would keep all samples about it, for as long as the recording is inspected.
        z, speed, residual = (values[:, k].copy() for values in (w.z, w.speed, mean))
        total = max(float(np.linalg.norm(mean[:, inside])), 1e-300)
        sharp = float(np.linalg.norm(removed[:, inside])) / total
        stretches.append(OutlierStretch(start, end, sizes, peak, z, speed, residual, sharp))
    return stretches


def without_recurring(
    outliers: Outliers,
    stretches: Sequence[OutlierStretch],
    low_pass: LowPass,
    margin: float,
) -> tuple[list[OutlierStretch], list[LeftSpan]]:
    """Stretches that neither friction nor play of a drive explains, and the spans of play.

    Args:
        outliers: which the stretches belong to.
        margin: time excluded about a change of sign, and about outliers there [s].
    """
    near, turns = _reach(low_pass), outliers.turns
    peaks = np.array([stretch.peak for stretch in stretches])
    first = np.array([np.argmax(stretch.sizes) for stretch in stretches], dtype=int)
    size = np.array([stretch.size for stretch in stretches])
    friction, play = np.zeros((2, len(stretches)), dtype=bool)
    for j, times in enumerate(outliers.reversals):
        of_joint = (first == j) | (j >= len(turns))
        if _recurs(peaks[of_joint], times, near, outliers.inspected)[0]:
            friction |= of_joint & _are_near(peaks, times, near)
    of_drives = [(first == i) & ~friction for i in range(len(turns))]
    rules = [
        _recurs(peaks[of_drive], times, near, outliers.inspected)
        for of_drive, times in zip(of_drives, turns, strict=True)
    ]
    spoilt: list[tuple[float, float, int]] = []
    if any(rule for rule, _ in rules):
        loose = [i for i, (_, as_well) in enumerate(rules) if as_well]
        usual = [of_drives[i] & _are_near(peaks, turns[i], near) for i in loose]
        about = [_are_near(peaks, times, _ABOUT * near) for times in turns]
        play = ~friction & _are_usual(size, np.any(usual, axis=0), np.any(about, axis=0))
        spoilt = [(t, t, i) for i in loose for t in turns[i].tolist()]
        for k in np.flatnonzero(play).tolist():
            gear = min(loose, key=lambda i: np.min(np.abs(turns[i] - peaks[k])))
            spoilt.append((stretches[k].start, stretches[k].end, gear))
    spans = [
        LeftSpan(start - margin, end + margin, BACKLASH, gear=gear) for start, end, gear in spoilt
    ]
    rest = ~(friction | play)
    return [stretch for stretch, remains in zip(stretches, rest, strict=True) if remains], spans


def at_changes(
    outliers: Outliers, stretches: Sequence[OutlierStretch], low_pass: LowPass
) -> Bool[np.ndarray, " _"]:
    """Which stretches recur where any joint reverses or any gear's torque changes its sign.

    `without_recurring` does not explain them: another drive's residual is the largest. Pushes come
    there by chance, unless that is less likely by a factor of `UNLIKELY` than that all stretches
    but such a share of them belong there.
    """
    near = _reach(low_pass)
    peaks = np.array([stretch.peak for stretch in stretches])
    size = np.array([stretch.size for stretch in stretches])
    recur = np.zeros(len(stretches), dtype=bool)
    if not stretches:  # perhaps no row was inspected
        return recur
    for changes in (outliers.turns, outliers.reversals):
        times = np.sort(np.concatenate(changes))
        are_near = _are_near(peaks, times, near)
        share = min(_share(times, near, outliers.inspected), 1.0 - UNLIKELY)
        by_chance = np.where(are_near, share, 1.0 - share)
        recurring = np.where(are_near, 1.0 - UNLIKELY, UNLIKELY)
        if np.log(recurring / by_chance).sum() > -np.log(UNLIKELY):
            recur |= _are_usual(size, are_near, are_near)
    return recur


def _reach(low_pass: LowPass) -> float:
    """Time within which an outlier belongs to a change of sign [s]."""
    return _NEAR + _PERIOD / low_pass.motion_cutoff


def _are_usual(
    size: Float[np.ndarray, " _"], usual: Bool[np.ndarray, " _"], about: Bool[np.ndarray, " _"]
) -> Bool[np.ndarray, " _"]:
    """Which stretches are about as large as usual ones; elsewhere than about changes less so."""
    return size <= np.where(about, _LARGER, _ELSEWHERE) * np.median(size[usual])


def _are_near(peaks: Times, times: Times, near: float) -> Bool[np.ndarray, " _"]:
    """Which peaks are near one of these ascending times."""
    after = np.append(times, np.inf)[np.searchsorted(times, peaks)]
    before = np.append(-np.inf, times)[np.searchsorted(times, peaks)]
    return np.minimum(after - peaks, peaks - before) <= near


def _recurs(peaks: Times, times: Times, near: float, duration: float) -> tuple[bool, bool]:
    """Whether peaks recur near these times; and whether they do if another drive's recur."""
    if not len(peaks) or not len(times):
        return False, False
    hits = int(_are_near(peaks, times, near).sum())
    chance = float(bdtrc(hits - 1, len(peaks), _share(times, near, duration)))  # of as many or more
    often = hits >= max(_FEWEST, 0.5 * len(peaks))
    return often and chance < NEVER, hits >= _AS_WELL and chance < UNLIKELY


def _share(times: Times, near: float, duration: float) -> float:
    """Share of a recording that is near one of these ascending times."""
    gaps = np.minimum(np.diff(times), 2 * near)
    return min(1.0, (gaps.sum() + 2 * near) / duration)
