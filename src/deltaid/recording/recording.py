"""A recording as a value: a surveyed log and its filter, whose windows come ready to use."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.filter import LowPass, design_low_pass, samples_needed
from deltaid.recording.log import Log, open_log
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.masks.directions import Directions
from deltaid.recording.masks.masks import before_stops
from deltaid.recording.memory import RecordingLike, as_sources
from deltaid.recording.spectrum import SpectrumEstimate
from deltaid.recording.time.clock import ClockReport
from deltaid.recording.windows import Uncut, Window, cut, reach

_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class Recording:
    """A log that may be computed with.

    Attributes:
        log: the file and what its survey found.
        low_pass: its filter; None if velocities and accelerations are taken as recorded.
    """

    log: Log
    low_pass: LowPass | None

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.log.path

    @property
    def cutoff(self) -> float | None:
        """The filter's cut-off [Hz]; None without one."""
        return self.low_pass.cutoff if self.low_pass else None

    @property
    def stride(self) -> int:
        """Every how many samples of the log `Window.smoothed` gives one."""
        return self.low_pass.stride if self.low_pass else 1

    @property
    def thinned(self) -> int:
        """Every how many samples of the log are kept in the end."""
        return self.low_pass.thinned if self.low_pass else 1

    @property
    def clock(self) -> ClockReport:
        """What was seen and done about its time."""
        shortest = reach(self.low_pass) + 1 if self.low_pass else 1
        return self.log.laid.report(self.log.bridged(self.cutoff), shortest)

    def evaluate(
        self, kinematics: Kinematics, work: Callable[[Window], _Result]
    ) -> Iterator[_Result]:
        """`work` done on every window, in order, in constant memory; windows share all cores.

        A filter's length is lost at both ends of each segment.
        """

        def done(uncut: Uncut) -> _Result:
            return work(uncut.window())

        return ordered(done, self._uncut(kinematics))

    def _uncut(self, kinematics: Kinematics) -> Iterator[Uncut]:
        """Windows to be made, segment by segment; none reaches beyond its segment."""
        log, start = self.log, 0
        directions = None if log.keep_all else self._directions
        for rows in log.segments(self.cutoff):
            for uncut in cut(rows, log.columns, kinematics, self.low_pass, directions):
                if uncut.samples:
                    yield replace(uncut, start=start)
                start += -(-uncut.samples // self.thinned) * self.thinned

    @property
    def _directions(self) -> Directions:
        """When joints turn round; the noise of recorded velocities is not known."""
        noise = np.zeros_like(self.log.position_noise)
        if self.low_pass and not self.log.columns.velocity:
            noise = self.log.position_noise * self.low_pass.speed_gain
        return Directions(1 / self.log.rate, noise)

    def windows(self, kinematics: Kinematics) -> Iterator[Window]:
        """All samples, window by window."""
        return self.evaluate(kinematics, lambda window: window)


def open_recordings(
    logs: RecordingLike | Sequence[RecordingLike],
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    cutoff: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
    *,
    keep_all: bool = False,
) -> list[Recording]:
    """Survey one or several recordings and choose a filter for each.

    Raises:
        RecordingError: there is none, one cannot be used, or two are the same.
    """
    sources = as_sources(logs)
    if not sources:
        raise RecordingError(
            "no log was given", where="logs", cure="give at least one recording: a file or a table"
        )
    recordings: list[Recording] = []
    for source in sources:
        progress(f"checking {source}")
        log = open_log(source, kinematics, mapping, keep_all=keep_all)
        _require_new(log, recordings)
        recordings.append(with_filter(log, cutoff))
    return recordings


def _require_new(log: Log, before: Sequence[Recording]) -> None:
    """Refuse a copy: it tells nothing new, but would count as twice the evidence."""
    same = [other.path for other in before if other.log.sha256 == log.sha256]
    if same:
        raise RecordingError(
            f"is the same recording as {same[0]}; a copy tells nothing new, but would narrow "
            "every interval",
            where=str(log.path),
            cure="give each recording once",
        )


def with_filter(log: Log, cutoff: float | None = None) -> Recording:
    """A log with its filter: none if velocities and accelerations are recorded, unless asked for.

    Raises:
        RecordingError: the log is too short, or the cut-off does not go with its rate.
    """
    if cutoff is None and log.has_derivatives:
        return Recording(log.cut_at(None, 1), None)
    cutoff = cutoff or log.suggested_cutoff
    # Before the design, because a tiny cut-off asks for an endless filter.
    needed = (
        samples_needed(cutoff, log.rate, str(log.path)) if cutoff else SpectrumEstimate.SHORTEST
    )
    if not cutoff:
        log.cut_at(None, SpectrumEstimate.SHORTEST)
    if not cutoff or log.samples < needed:
        at = f" at {cutoff:.4g} Hz" if cutoff else ""
        raise RecordingError(
            f"has {log.samples} samples, too few to filter and differentiate{at} (at least "
            f"{needed:g})",
            where=str(log.path),
            cure="record longer, or record velocities and accelerations as well",
        )
    low_pass = design_low_pass(cutoff, log.rate)
    masks = before_stops(log.masks, cutoff, log.rate)
    log = log if masks == log.masks else replace(log, masks=masks)
    return Recording(log.cut_at(cutoff, reach(low_pass) + 1), low_pass)
