"""The time of a recording: what its first pass looks at, and what is known of it in the end."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import RecordingError
from deltaid.recording.filter import LOWEST_RATE
from deltaid.recording.masks.masks import Runs
from deltaid.recording.source import LogTable
from deltaid.recording.time.grid import FASTEST, usual_step

# A step that is off the usual one by more than this share is uneven.
_JITTER = 0.05
# Rows so many usual steps apart are not compared with one another.
_APART = 5.0
# A time column that goes back in a larger share of its rows is none.
_MOST_BACKWARD = 0.2
# Fewest steps of stamps that several rows share; fewer do not tell the rate.
_FEWEST_STEPS = 32
# No drive is sampled faster [Hz]; a higher rate is a wrong unit of time.
HIGHEST_RATE = 1e6


@dataclass(frozen=True, eq=False)
class Clock:
    """How the rows of a recording lie in time.

    Rows are counted from 0 here.

    Attributes:
        period: from one sample to the next [s].
        rows: of the recording.
        steady: whether all rows are there and stamped evenly, so that they are taken as they are.
        even: whether samples were taken evenly, however they are stamped; None where the motion is
            too slow to show it (they are then taken as even).
        jitter: of the stamps against the even grid [s, rms]; 0 if steady.
        wild, first_wild: how many rows are left out since their stamps are far off those before and
            after, and the first such row; −1 without any.
        extra: rows that are left out, since they are there twice or have no place of their own.
        doubled, late: how many of these only repeat the row before them, or have no place of their
            own.
        holes: rows before which some are missing, or before which time starts again.
        lost: how many are missing there; −1 where time starts again.
        since, until: stamps of the rows before and after each hole [s].
        first, last: stamps of the first and last row [s].
    """

    period: float
    rows: int
    first: float
    last: float
    steady: bool = True
    even: bool | None = True
    jitter: float = 0.0
    wild: int = 0
    first_wild: int = -1
    extra: Int[np.ndarray, " extra"] = field(default_factory=lambda: np.zeros(0, int))
    doubled: int = 0
    late: int = 0
    holes: Int[np.ndarray, " holes"] = field(default_factory=lambda: np.zeros(0, int))
    lost: Int[np.ndarray, " holes"] = field(default_factory=lambda: np.zeros(0, int))
    since: Float[np.ndarray, " holes"] = field(default_factory=lambda: np.zeros(0))
    until: Float[np.ndarray, " holes"] = field(default_factory=lambda: np.zeros(0))

    @property
    def rate(self) -> float:
        """Samples a second [Hz]; infinite if time does not run."""
        return 1 / self.period if self.period else np.inf

    def stamps(self, rows: Int[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        """About when rows were written [s]."""
        known = np.column_stack([self.holes - 1, self.holes]).ravel()
        times = np.column_stack([self.since, self.until]).ravel()
        return np.interp(
            rows,
            np.concatenate([[0], known, [self.rows - 1]]),
            np.concatenate([[self.first], times, [self.last]]),
        )

    def without(self, runs: Runs) -> "Clock":
        """The same with each of some runs of rows lost: the hole stands before the row after it."""
        if not len(runs):
            return self
        gone = np.concatenate([np.arange(first, last + 1) for first, last in runs])
        extra = np.union1d(self.extra, gone)
        holes = np.stack([self.holes, self.lost, self.since, self.until], axis=1)
        for first, last in runs:
            after = last + 1
            while after < self.rows and np.any(extra == after):
                after += 1
            inside = (holes[:, 0] >= first) & (holes[:, 0] <= after)
            before = holes[inside, 1]
            lost = -1 if (before < 0).any() else last - first + 1 + before.sum()
            new = [after, lost, *self.stamps(np.array([first - 1, after]))]
            holes = np.vstack([holes[~inside], new])
        holes = holes[holes[:, 0] < self.rows]
        at, lost, since, until = holes[np.argsort(holes[:, 0])].T
        return replace(
            self, steady=False, extra=extra, holes=at.astype(int), lost=lost.astype(int),
            since=since, until=until,
        )  # fmt: skip

    def cuts(self, longest: int) -> Bool[np.ndarray, " holes"]:
        """Which holes end a segment: more rows missing than may be bridged, or time that restarts.

        Args:
            longest: rows that may be bridged.
        """
        return (self.lost > longest) | (self.lost < 0)

    def segments(self, longest: int) -> Int[np.ndarray, " segments"]:
        """Samples of each segment, bridged ones with them."""
        cuts = self.cuts(longest)
        before = np.concatenate([[0], self.holes[cuts], [self.rows]])
        rows = np.diff(before - np.searchsorted(self.extra, before))
        bridged = np.bincount(np.cumsum(cuts), np.where(cuts, 0, self.lost), len(rows))
        return rows + bridged.astype(int)

    def report(self, longest: int, shortest: int) -> "ClockReport":
        """What was seen and done, in numbers.

        Args:
            longest: rows missing that are bridged.
            shortest: samples that a segment must have to be of use.
        """
        cuts, restarts = self.cuts(longest), self.lost < 0
        gaps, sizes = cuts & ~restarts, self.segments(longest)
        return ClockReport(
            rate_hz=self.rate,
            steady=self.steady,
            even=self.even,
            jitter_s=self.jitter,
            wild=self.wild,
            doubled=self.doubled,
            out_of_place=self.late,
            bridged=int(self.lost[~cuts].sum()),
            gaps=tuple(zip(self.since[gaps].tolist(), self.until[gaps].tolist(), strict=True)),
            restarts=int(restarts.sum()),
            segments=int((sizes >= shortest).sum()),
            too_short=float(sizes[sizes < shortest].sum() / max(1, sizes.sum())),
        )


@dataclass(frozen=True)
class ClockReport:
    """The time of a recording, for programs.

    Attributes:
        rate_hz: samples a second.
        steady: whether all rows are there and stamped evenly, so that nothing had to be done.
        even: whether samples were taken evenly, however they are stamped; None if the motion is
            too slow to show it. If not, they are interpolated.
        jitter_s: of the stamps against the even grid, rms.
        wild, doubled, out_of_place: rows left out, because their stamps are far off those before
            and after, they repeat the row before, or are late.
        bridged: rows that are missing in short holes, made up for by the motion about them.
        gaps: from and to, in seconds, of those that no filter reaches across.
        restarts: how often time starts again.
        segments: that are long enough for the filter.
        too_short: share of the samples in those that are not.
    """

    rate_hz: float
    steady: bool
    even: bool | None
    jitter_s: float
    wild: int
    doubled: int
    out_of_place: int
    bridged: int
    gaps: tuple[tuple[float, float], ...]
    restarts: int
    segments: int
    too_short: float


class ClockCheck:
    """First look at consecutive rows: whether they are steady, and whether there is a time at all.

    Attributes:
        table, column: the log, and which of its columns is the time.
        samples: rows so far.
        step: the usual time between two rows, a median [s].
        period: the same, if several rows share a stamp as well.
        first_time, last_time: of the rows so far [s].
        uneven, backward, forward: steps that are uneven, negative, positive.
    """

    def __init__(self, table: LogTable, column: str) -> None:
        self.table, self.column = table, column
        self.samples = self.uneven = self.backward = self.forward = 0
        self.step, self.period, self._apart = 0.0, 0.0, np.inf
        self.first_time = self.last_time = np.nan

    @property
    def steady(self) -> bool:
        """Whether all steps are alike, so that nothing is missing."""
        return not self.uneven

    @property
    def clock(self) -> Clock:
        """Of a steady recording: its rate is the mean."""
        period = (self.last_time - self.first_time) / (self.samples - 1)
        return Clock(period, self.samples, self.first_time, self.last_time)

    def add(self, time: Float[np.ndarray, " rows"]) -> Int[np.ndarray, " runs"]:
        """Take in stamps of consecutive rows; gives those before which time leaves off, from 0."""
        steps = np.diff(time, prepend=self.last_time)
        known = steps[~np.isnan(steps)]
        if not self.step and known.size:
            self.step = float(np.median(known))
            usual = self.step if self.step > 0 else usual_step(time)[0]
            self.period = max(usual, FASTEST) if usual else 0.0
            self._apart = _APART * max(self.step, float(np.quantile(known, 0.95)))
        if not self.samples:
            self.first_time = float(time[0])
        self.last_time = float(time[-1])
        self.backward += int(np.count_nonzero(known < 0))
        self.forward += int(np.count_nonzero(known > 0))
        self.uneven += int(np.count_nonzero(np.abs(known - self.step) > _JITTER * self.step))
        self.uneven += int(self.step <= 0 < known.size)
        self.samples += len(time)
        return np.flatnonzero(np.abs(steps) > self._apart)

    def require_time(self) -> None:
        """Refuse what is no time.

        Raises:
            RecordingError: it stands still, or nearly so, goes backwards, or jumps about; or there
                are too few rows.
        """
        where, samples = str(self.table.path), self.samples
        if samples < 2:
            cure = "give a whole recording"
            raise RecordingError("has fewer than two rows of data", where=where, cure=cure)
        if not self.forward and self.backward:
            what = "runs backwards"
        elif not self.forward:
            what = f"is {self.first_time:.10g} s in all rows: it does not run"
        elif self.forward < _FEWEST_STEPS and 2 * self.forward < samples - 1:
            what = (
                f"changes in only {self.forward} of {samples} rows, too few to determine the "
                "sampling rate"
            )
        elif self.backward > _MOST_BACKWARD * samples:
            what = f"goes back in {self.backward} of {samples} rows; it is no time"
        else:
            return
        raise RecordingError(
            f"column {self.column} {what}",
            where=where,
            cure="map the column of the time with --columns MAPPING.yaml (time: {column: NAME}), "
            "or give the sampling rate in its place (time: {rate: 1000})",
        )


def require_rate(table: LogTable, column: str, rate: float, *, differentiated: bool) -> None:
    """Refuse a rate at which nothing is sampled, or positions cannot be differentiated.

    Raises:
        RecordingError: with what can be.
    """
    slow = differentiated and rate < LOWEST_RATE
    if slow or rate > HIGHEST_RATE:
        limit = f"at least {LOWEST_RATE:g}" if slow else f"at most {HIGHEST_RATE:g}"
        raise RecordingError(
            f"column {column} makes a sampling rate of {rate:.4g} Hz; {limit} Hz can be",
            where=str(table.path),
            cure="declare the unit of time with --columns MAPPING.yaml (time: {column: "
            f"{column}, unit: ms}}), or record faster",
        )
