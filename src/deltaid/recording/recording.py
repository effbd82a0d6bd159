"""Prepared recordings: a surveyed log with filter and repairs, evaluated window by window."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.columns import Rows
from deltaid.recording.delay import in_time
from deltaid.recording.filter import LowPass, design_low_pass, no_filter, samples_needed
from deltaid.recording.log import MOST_WINDOWS, Excerpt, Log
from deltaid.recording.mapping import ColumnMappings, mapping_each
from deltaid.recording.masks.masks import before_stops
from deltaid.recording.memory import RecordingLike, as_sources
from deltaid.recording.opening import open_log
from deltaid.recording.repairs import Repairs, Samples, TorqueDrift, burden_of
from deltaid.recording.row_sample import REPEATED, shared_rows
from deltaid.recording.spectrum import SpectrumEstimate
from deltaid.recording.time.clock import ClockReport
from deltaid.recording.windows import WINDOW, Directions, Window, blocks, window_of
from deltaid.robot.description import RobotDescription
from deltaid.shown import Shown

_Result = TypeVar("_Result")
# Number of inner samples of a window, and the function that makes it.
_WindowMaker = tuple[int, Callable[[], Window]]


@dataclass(frozen=True, eq=False, repr=False)
class PreparedRecording(Shown):
    """A log that is ready for computations.

    Attributes:
        log: the surveyed log.
        low_pass: filter of the log; None if velocities and accelerations are used as recorded.
        repairs: corrections of the rows.
        excerpt: stretches that represent the log; None before they have been read.
        every: k if every k-th window is evaluated.
        before: rows ahead of the first one, as many as the filter takes, in blocks, columns as in
            `Log.batches`; empty if unknown.
        after: rows behind the last one, at least as many as the filter takes; empty if unknown.
        path: path of the recording.
        cutoff, motion_cutoff: cut-offs of the filter over rows and over positions [Hz]; None
            without a filter.
    """

    log: Log
    low_pass: LowPass | None
    repairs: Repairs = field(default_factory=Repairs)
    excerpt: Excerpt | None = None
    every: int = 1
    before: tuple[Rows, ...] = ()
    after: tuple[Rows, ...] = ()

    @property
    def path(self) -> Path:
        return self.log.path

    @property
    def cutoff(self) -> float | None:
        return self.low_pass.cutoff if self.low_pass else None

    @property
    def motion_cutoff(self) -> float | None:
        return self.low_pass.motion_cutoff if self.low_pass else None

    @property
    def filter(self) -> LowPass:
        """Filter of the windows: `low_pass`, or the identity."""
        return self.low_pass or no_filter(self.log.rate)

    @property
    def clock(self) -> ClockReport:
        return self.log.laid.report(self.log.bridged(self.motion_cutoff), self.filter.reach + 1)

    def excerpted(self) -> "PreparedRecording":
        """Recording with its excerpt, for which the log is read once."""
        return replace(self, excerpt=self.log.excerpt(self.motion_cutoff, self.filter))

    def repaired(self, **repairs: Any) -> "PreparedRecording":
        return replace(self, repairs=replace(self.repairs, **repairs))

    def drifting(self, coefficients: Iterable[Sequence[float]] = ()) -> TorqueDrift:
        """Drift of torque constants over the recording, by a, b and c of each drive; models of
        before have no c."""
        log, each = self.log, tuple((a, b, sum(c)) for a, b, *c in coefficients)
        return TorqueDrift(log.clock.first, log.samples / log.rate, each)

    @property
    def brief(self) -> "PreparedRecording":
        """Excerpt as a recording; the whole recording if it has no excerpt."""
        if self.excerpt is None:
            return self
        return replace(self, log=replace(self.log, held=self.excerpt))

    def sparser(self, windows: int) -> "PreparedRecording":
        """Recording thinned to evenly spread windows, at least `windows` of them."""
        return replace(self, every=max(1, self.log.samples // (windows * WINDOW)))

    def evaluate(
        self, kinematics: Kinematics, work: Callable[[Window], _Result]
    ) -> Iterator[_Result]:
        """Results of `work` on every window, in order, in constant memory, on all cores.

        The filter takes some samples at both ends of each segment.
        """

        def done(uncut: _WindowMaker) -> _Result:
            return work(uncut[1]())

        return ordered(done, islice(self._window_makers(kinematics), None, None, self.every))

    def _window_makers(self, kinematics: Kinematics) -> Iterator[_WindowMaker]:
        """Functions that make the windows of each segment; no window reaches beyond its segment."""
        log, low_pass, repairs, start = self.log, self.filter, self.repairs, 0
        directions = None
        if not log.keep_all:
            noise = np.zeros_like(log.position_noise)  # noise of recorded velocities is unknown
            if not log.columns.velocity:
                noise = log.position_noise * low_pass.speed_gain
            settling = repairs.gears.settling if repairs.gears else 0.0
            smear = repairs.smear(log.rate)
            directions = Directions(1 / log.rate, noise, smear, repairs.turns, settling)
        about = (log.columns, kinematics, low_pass, directions, self.burden(kinematics.robot))
        for segment in log.segments(self.motion_cutoff):
            timed = in_time(segment, log.columns, log.rate)
            repaired = repairs.apply(timed, log.columns, log.rate)
            for rows in blocks(chain(self.before, repaired, self.after), low_pass):
                if samples := low_pass.samples_of(len(rows)):
                    yield samples, partial(window_of, rows, start, *about)
                start += -(-samples // low_pass.thinned) * low_pass.thinned

    def burden(self, robot: RobotDescription) -> Callable[..., Samples] | None:
        """Torques of held loads and external causes, as `burden_of` returns them; None without."""
        loads, pulls = self.repairs.loads, self.repairs.pulls
        return burden_of(robot, self.log.columns, loads, pulls) if loads or pulls else None

    @property
    def without(self) -> tuple[int, int]:
        """Numbers of rows at the beginning and the end for which the filter gives no samples; 0 if
        rows are not steady."""
        if not self.log.laid.steady:
            return 0, 0
        start = 0 if self.before else self.filter.first_row
        if self.after:
            return start, 0
        rows = self.log.samples + self.filter.first_row - start
        return start, self.log.samples - start - self.filter.samples_of(rows)

    def changed(self, cutoff: float | None, **log: Any) -> "PreparedRecording":
        """Recording with another filter and other fields of its log; repairs are kept.

        Args:
            cutoff: cut-off of the filter [Hz]; None for the suggested one.
            log: new fields of the log.

        Raises:
            RecordingError: the log is too short, or the cut-off does not fit its rate.
        """
        recording = with_filter(replace(self.log, **log), cutoff)
        return replace(recording, repairs=self.repairs, excerpt=self.excerpt)

    def windows(self, kinematics: Kinematics) -> Iterator[Window]:
        return self.evaluate(kinematics, lambda window: window)

    def spread(self, kinematics: Kinematics, most: int) -> Iterator[Window]:
        """Evenly spread windows that have about as many rows as `most` full windows.

        Gaps shorten windows, so there may be more than `most`.
        """
        every, rows = list[Callable[[], Window]](), 0
        for samples, make in self._window_makers(kinematics):
            every.append(make)
            rows += samples
            if rows >= MOST_WINDOWS * WINDOW:  # of a log without an excerpt, only the beginning
                break
        count = max(most, round(most * WINDOW * len(every) / max(rows, 1)))
        chosen = np.unique(np.linspace(0, len(every) - 1, count).round().astype(int))
        return ordered(lambda make: make(), [every[k] for k in chosen] if every else [])


def open_recordings(
    logs: RecordingLike | Sequence[RecordingLike],
    kinematics: Kinematics,
    columns: ColumnMappings = None,
    cutoff: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
    *,
    keep_all: bool = False,
) -> list[PreparedRecording]:
    """Survey one or several recordings and choose a filter for each.

    Args:
        columns: names and units of their columns: one mapping for all, or one each.
        cutoff: cut-off of the filters [Hz]; None for suggested ones.
        progress: function that is called with messages about the progress.
        keep_all: whether no rows are excluded.

    Raises:
        RecordingError: no recording is given, one cannot be used, or two have the same rows.
    """
    sources, recordings = as_sources(logs), list[PreparedRecording]()
    if not sources:
        raise RecordingError(
            "no log was given", where="logs", cure="give at least one recording: a file or a table"
        )
    for source, mapping in zip(sources, mapping_each(columns, len(sources)), strict=True):
        progress(f"checking {source}")
        log = open_log(source, kinematics, mapping, keep_all=keep_all)
        for other in recordings:
            _require_other_rows(log, other.log)
        recordings.append(with_filter(log, cutoff))
    return recordings


def _require_other_rows(log: Log, other: Log) -> None:
    """Refuse a recording that has rows of another one: the same evidence would count twice."""
    share = 1.0 if log.sha256 == other.sha256 else shared_rows(log.sample, other.sample)
    if share < REPEATED:
        return
    what = f"has the rows of {other.path}, {100 * share:.0f} % of the shorter of both"
    what = f"is the same recording as {other.path}" if log.sha256 == other.sha256 else what
    raise RecordingError(
        f"{what}; a copy adds nothing new, but would narrow every interval",
        where=str(log.path),
        cure="give each recording once",
    )


def _resting(log: Log) -> int:
    """Number of rows at rest: all if three drives never move the platform, else masked ones."""
    low, high = log.reach
    if len(log.columns.position) == len(low) and np.array_equal(low, high):
        return log.samples
    return sum(m.last - m.first + 1 for m in log.masks if m.reason == "standing still")


def with_filter(log: Log, cutoff: float | None = None) -> PreparedRecording:
    """Prepare a log with its filter.

    Args:
        cutoff: cut-off [Hz]; by default the suggested one, or no filter if velocities and
            accelerations are recorded.

    Raises:
        RecordingError: the log is too short, or the cut-off does not fit its rate.
    """
    if cutoff is None and log.has_derivatives:
        return PreparedRecording(log.cut_at(None, 1), None)
    cutoff, needed = cutoff or log.suggested_cutoff, SpectrumEstimate.SHORTEST
    if cutoff:  # before the design, because a tiny cut-off makes the filter extremely long
        needed = samples_needed(cutoff, log.rate, str(log.path))
    else:
        log.cut_at(None, needed)
    if not cutoff or log.samples < needed:
        at, cure = f" at {cutoff:.4g} Hz" if cutoff else "", "record longer"
        samples = f"{log.samples} samples"
        if resting := _resting(log):
            samples += f", {resting} of them at rest"
            cure = "record a motion, such as `deltaid excite` plans"
        raise RecordingError(
            f"has {samples}, too few to filter and differentiate{at} (at least {needed:g})",
            where=str(log.path),
            cure=f"{cure}, or record velocities and accelerations as well",
        )
    low_pass = design_low_pass(cutoff, log.rate, motion_cutoff=log.motion_cutoff or 0.0)
    log = replace(log, masks=before_stops(log.masks, low_pass.motion_cutoff, log.rate))
    return PreparedRecording(log.cut_at(low_pass.motion_cutoff, low_pass.reach + 1), low_pass)
