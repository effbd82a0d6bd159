"""Stretches of a recording whose torques are outliers against a fit, in one pass.

The residual's mean over 9 ms is compared with its usual scatter: a stretch begins and ends where a
drive's is within 3 standard deviations, and counts if it is beyond 6 somewhere. Both are wider
where the scatter is no noise but a model that does not fit. Single outliers are spikes, and are
searched first. Windows overlap, so that their cuts do not show.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from deltaid.identification.expectation import NOISE, Expectation, deviation
from deltaid.identification.looked import ROUGH, STRONG, InspectedWindow, glance
from deltaid.recording.masks.runs import runs_of
from deltaid.recording.repairs import SPIKE, LeftSpan
from deltaid.recording.windows import Window

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

OfDrives = Float[np.ndarray, " dof"]


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive samples that are outliers.

    Attributes:
        start, end: when [s].
        sizes: how far each drive's does at most, in units of the threshold that it had to reach.
        peak: when that was [s].
        z: task coordinates there.
        speed: of the drives there, as shares of their usual ones.
        left: residual torques there, mean over 9 ms [N m or N].
        sharp: size of the torques of what the low-pass took off the motion there, as a share.
    """

    start: float
    end: float
    sizes: OfDrives
    peak: float
    z: OfDrives
    speed: OfDrives
    left: OfDrives
    sharp: float

    @property
    def size(self) -> float:
        """The largest of the drives' sizes."""
        return float(self.sizes.max())

    def with_next(self, other: "Stretch") -> "Stretch":
        """Both as one, with the peak of the larger."""
        return replace(other if other.size > self.size else self, start=self.start, end=other.end)


@dataclass(frozen=True, eq=False)
class Outstanding:
    """Outliers of a recording, and when drives might have caused them.

    Attributes:
        stretches: in the order of time.
        spikes: single samples of a drive.
        inspected: duration of the inspected windows [s].
        turns: when in these the torque that a gear carries changes its sign, drive by drive [s].
        reversals: when a joint turns round, drives first, then passive joints with friction [s].
    """

    stretches: tuple[Stretch, ...]
    spikes: tuple[LeftSpan, ...]
    inspected: float
    turns: tuple[Float[np.ndarray, " _"], ...]
    reversals: tuple[Float[np.ndarray, " _"], ...]

    @property
    def is_empty(self) -> bool:
        return not (self.stretches or self.spikes)


@dataclass
class Course:
    """Stretches along a recording, those no more than `gap` [s] apart as one.

    Of those that fall short of the threshold no more is kept than the number that nearly reach it.
    """

    gap: float
    reaching: list[Stretch] = field(default_factory=list[Stretch])
    nearly: int = 0

    def join(self, stretches: Iterable[Stretch]) -> None:
        """Add stretches; the first may go on where the last one ended."""
        for stretch in stretches:
            if self.reaching and stretch.start - self.reaching[-1].end <= self.gap:
                self.reaching[-1] = self.reaching[-1].with_next(stretch)
            else:
                self.end()
                self.reaching.append(stretch)

    def end(self) -> None:
        """End the last one, and drop it if it falls short: noise has many like it."""
        if self.reaching and self.reaching[-1].size < 1.0:
            self.nearly += self.reaching.pop().size >= _NEARLY


def outstanding(expected: Expectation) -> Outstanding:
    """Outliers of a recording, in one pass over it."""
    recording, kinematics = expected.source.recording, expected.source.dynamics.kinematics
    return _outliers(expected, recording.evaluate(kinematics, lambda w: glance(expected, w)))


def stands_out(expected: Expectation, window: Window) -> bool:
    return not _outliers(expected, [glance(expected, window)]).is_empty


def _outliers(expected: Expectation, windows: Iterable[InspectedWindow | None]) -> Outstanding:
    """Outliers of the inspected windows."""
    step, inspected = 1.0 / expected.rate, 0
    wider = np.clip(expected.misfit / NOISE, 1.0, _WIDEST)
    narrow, wide = Course(_GAP * step), Course(_GAP * step)
    changes, spikes = list[list[np.ndarray]](), list[LeftSpan]()
    for part in _together(w for w in windows if w is not None and len(w.time)):
        inspected += len(part.time)
        changes.append([part.time[flags] for flags in part.signs])
        local = np.maximum(1.0, deviation(part.size))
        cuts = np.flatnonzero(np.diff(part.time) > _GAP * step) + 1
        for first, last in zip([0, *cuts], [*cuts, len(part.time)], strict=True):
            run = part.part(slice(first, last))
            spikes += _spikes(run, step)
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
    return Outstanding(kept, tuple(spikes), inspected * step, times[:dof], times[dof:])


def _together(windows: Iterable[InspectedWindow]) -> Iterator[InspectedWindow]:
    """Windows in groups of some seconds; a short rest belongs to the last."""
    ready: list[InspectedWindow] = []
    waiting: list[InspectedWindow] = []
    for window in windows:
        waiting.append(window)
        if window.time[-1] - waiting[0].time[0] >= _TOGETHER:
            if ready:
                yield InspectedWindow.joined(ready)
            ready, waiting = waiting, []
    if ready or waiting:
        yield InspectedWindow.joined([*ready, *waiting])


def _spikes(w: InspectedWindow, step: float) -> list[LeftSpan]:
    """Runs of spikes of each drive, with the time between two samples about them."""
    return [
        LeftSpan(float(w.time[first]) - step, float(w.time[last]) + step, SPIKE, (drive,))
        for drive, flags in enumerate(w.spikes)
        for first, last in runs_of(flags)
    ]


def _stretches(w: InspectedWindow, limits: OfDrives) -> list[Stretch]:
    """Runs of samples without a gap in which any drive is beyond the weak threshold."""
    lasting = np.nan_to_num(np.abs(w.size)) / (STRONG * limits[:, None])
    size = np.maximum(lasting, np.nan_to_num(w.rough) / ROUGH)
    taken, mean = np.nan_to_num(w.taken), np.nan_to_num(w.mean)
    stretches: list[Stretch] = []
    for first, last in runs_of(np.any(size > _WEAK / STRONG, axis=0)).tolist():
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
        stretches.append(Stretch(start, end, sizes, peak, z, speed, residual, sharp))
    return stretches
