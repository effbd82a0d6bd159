"""The clock of a recording: times of its rows, and doubts about them."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.masks.masks import Runs
from deltaid.recording.source import LogTable
from deltaid.recording.time.restarts import part_column
from deltaid.recording.units import MOST_WRONG

# Highest rate of drives [Hz]; a higher one is a wrong unit of time.
HIGHEST_RATE = 1e6
NO_TIME = (
    "map the column of the time with --columns MAPPING.yaml (time: {column: NAME}), or give the "
    "sampling rate in its place (time: {rate: 1000})"
)
# Jitter that needs no explanation [periods, rms].
JITTER = 0.01


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of the rows of a recording, which are counted from 0.

    Attributes:
        period: between samples [s].
        rows: of the recording.
        steady: whether no row is missing and stamps are even, so that rows are used as they are.
        even: whether samples were taken evenly, whatever their stamps; None if the motion is too
            slow to show it (samples then count as even).
        jitter: of the stamps against the even grid [s, rms]; 0 if steady.
        wild, first_wild: number of rows excluded for stamps far off their neighbours, and the first
            such row; −1 without any.
        extra: rows excluded because they occur twice or have no place on the grid.
        doubled, late: number of these that repeat the row before them, and that have no place.
        holes: rows before which rows are missing or time restarts.
        lost: number of missing rows there; −1 if time restarts.
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
        """Sampling rate [Hz]; infinite if time does not run."""
        return 1 / self.period if self.period else np.inf

    def stamps(self, rows: Int[np.ndarray, " _"]) -> Float[np.ndarray, " _"]:
        """Approximate times of rows [s]."""
        known = np.column_stack([self.holes - 1, self.holes]).ravel()
        times = np.column_stack([self.since, self.until]).ravel()
        return np.interp(
            rows,
            np.concatenate([[0], known, [self.rows - 1]]),
            np.concatenate([[self.first], times, [self.last]]),
        )

    def without(self, runs: Runs) -> "Clock":
        """The clock with runs of rows as holes before the rows that follow."""
        if not len(runs):
            return self
        removed = np.concatenate([np.arange(first, last + 1) for first, last in runs])
        extra = np.union1d(self.extra, removed)
        holes = np.stack([self.holes, self.lost, self.since, self.until], axis=1)
        there = np.append(np.delete(np.arange(self.rows), extra), self.rows)
        for first, last in runs:
            after = int(there[np.searchsorted(there, last)])
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
        """Which holes end a segment: those too long to bridge, and restarts of time.

        Args:
            longest: most missing rows that are bridged.
        """
        return (self.lost > longest) | (self.lost < 0)

    def segments(self, longest: int) -> Int[np.ndarray, " segments"]:
        """Number of samples of each segment, including bridged ones."""
        cuts = self.cuts(longest)
        before = np.concatenate([[0], self.holes[cuts], [self.rows]])
        rows = np.diff(before - np.searchsorted(self.extra, before))
        bridged = np.bincount(np.cumsum(cuts), np.where(cuts, 0, self.lost), len(rows))
        return rows + bridged.astype(int)

    def report(self, longest: int, shortest: int) -> "ClockReport":
        """The clock for programs.

        Args:
            longest: most missing rows that are bridged.
            shortest: fewest samples of a usable segment.
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
    """The clock of a recording, for programs.

    Attributes:
        rate_hz: sampling rate.
        steady: whether no row is missing and stamps are even.
        even: whether samples were taken evenly, whatever their stamps; None if the motion is too
            slow to show it. Uneven samples are interpolated.
        jitter_s: of the stamps against the even grid, rms.
        wild, doubled, out_of_place: number of rows excluded because their stamps are far off their
            neighbours, because they repeat the row before, or because they are late.
        bridged: number of missing rows in short holes, which are interpolated.
        gaps: start and end [s] of holes that end a segment.
        restarts: number of times that time restarts.
        segments: number of those that are long enough for the filter.
        too_short: share of the samples in other segments.
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


def doubts_about_stamps(clock: Clock, table: LogTable, column: str) -> Iterator[Doubt]:
    """Doubts about wild stamps, jitter, uneven sampling and excluded rows.

    Raises:
        RecordingError: too many stamps are wild.
    """
    if clock.wild > MOST_WRONG * clock.rows:
        raise RecordingError(
            f"column {column} jumps about: {clock.wild} of {clock.rows} stamps are far off those "
            "before and after them; it is no time",
            where=table.row_place(table.first_row + clock.first_wild),
            cure=NO_TIME,
        )
    if clock.wild:
        yield Doubt(
            f"{column} of {rows_are(clock.wild)} far off the stamps before and after, the first "
            f"in {_row(table, np.array([clock.first_wild]))}: excluded",
            cause="numbers that were damaged on their way into the file",
            cure="export the log again if there are many",
            key="clock",
        )
    share = clock.jitter * clock.rate
    off = f"{1e3 * clock.jitter:.3g} ms rms ({100 * share:.2g} % of a step)"
    if clock.even is False:
        yield Doubt(
            f"samples were taken at uneven times, off by {off}: positions follow the stamps of "
            f"{column}, so all is interpolated at {clock.rate:.6g} Hz",
            cause="the logger asks the controller when it finds time to",
            cure="log in the controller's own cycle",
            key="clock",
        )
    elif share > JITTER:
        why = "positions are even" if clock.even else "positions do not show which is right"
        yield Doubt(
            f"stamps of {column} jitter by {off}; {why}, so rows are taken as evenly spaced at "
            f"{clock.rate:.6g} Hz",
            cause="rows are stamped when they are written, not when they are measured",
            cure="record the controller's own time or count of cycles"
            + ("" if clock.even else "; if rows are known to be even, declare `rate:`"),
            key="clock",
        )
    if clock.doubled:
        yield Doubt(
            f"{rows_are(clock.doubled)} there twice and excluded once, the first in "
            f"{_row(table, clock.extra)}",
            cause="the logger ran ahead of the controller, or a packet came twice",
            cure="nothing is lost; to avoid it, log once a cycle of the controller",
            key="clock",
        )
    if others := clock.late:
        yield Doubt(
            f"{rows_are(others)} late or stamped like another one, and excluded"
            + ("" if clock.doubled else f", the first in {_row(table, clock.extra)}"),
            cause="packets overtook one another on their way to the logger",
            cure="log with the controller's own stamps, sorted by them",
            key="clock",
        )


def restarted(clock: Clock, table: LogTable, column: str) -> tuple[str, str, str]:
    """Where time starts again, the likeliest cause, and the fix; empty where it does not.

    Args:
        column: of the time.
    """
    rows = clock.holes[clock.lost < 0]
    if not rows.size:
        return "", "", ""
    seen = f"time starts again in {places_of(rows.size)}, the first in {_row(table, rows)}"
    if (part := part_column(table, column, rows.tolist())) is None:
        return (
            seen,
            "several recordings stand in one file, or the clock was set or passed midnight",
            "split it if load or wiring were others; else nothing is to be done",
        )
    return (
        f"{seen}, and column {part.name} changes there only, first from {part.before} to "
        f"{part.after}",
        "recordings of several robots or runs stand in one file",
        f"split it by column {part.name}, unless all of it is of one robot with the same load and "
        "wiring",
    )


def doubts_about_holes(
    clock: Clock, table: LogTable, column: str, longest: int, shortest: int
) -> Iterator[Doubt]:
    """Doubts about bridged holes, gaps, and segments that are too short.

    Args:
        column: of the time.
        longest: most missing rows that are bridged.
        shortest: fewest samples of a usable segment.

    Raises:
        RecordingError: no segment is usable.
    """
    report, sizes = clock.report(longest, shortest), clock.segments(longest)
    if report.bridged:
        holes = clock.holes[~clock.cuts(longest)]
        yield Doubt(
            f"{rows_are(report.bridged)} missing in {places_of(holes.size)} "
            f"({100 * report.bridged / clock.rows:.2g} % of the recording), the first before "
            f"{_row(table, holes)}: bridged by the motion about them, torques there do not "
            "count",
            cause="packets were lost on their way to the logger",
            cure="nothing is to be done for a few; else log on the controller itself",
            key="clock",
        )
    if report.restarts:
        seen, cause, cure = restarted(clock, table, column)
        yield Doubt(f"{seen}: a new segment begins there", cause=cause, cure=cure, key="clock")
    if gaps := report.gaps:
        spans = [f"{since:.6g} to {until:.6g} s" for since, until in gaps[:5]]
        shown = ", ".join(spans) + (" …" if len(gaps) > 5 else "")
        yield Doubt(
            f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} of up to "
            f"{1e3 * max(until - since for since, until in gaps):.4g} ms ({shown}): no filter "
            "reaches across",
            cause="logging stopped, or its buffer ran over",
            cure="log fewer channels or at a lower rate if gaps come again and again",
            key="clock",
        )
    if not report.segments:
        raise RecordingError(
            f"has no stretch of {shortest} samples without a gap; the longest has "
            f"{sizes.max()}, between {places_of(len(sizes) - 1)} where rows are missing or time "
            "starts again",
            where=str(table.path),
            cure="record without gaps, or lower the rate at which the logger falls behind; a "
            "higher --cutoff needs shorter stretches",
        )
    if short := len(sizes) - report.segments:
        yield Doubt(
            f"{short} of {len(sizes)} stretches between gaps are shorter than the "
            f"{shortest} samples that the filter needs, and excluded: "
            f"{100 * report.too_short:.2g} % of the recording",
            cause="gaps follow close on one another",
            cure="record without gaps, or take a higher --cutoff, whose filter is shorter",
            key="clock",
        )


def _row(table: LogTable, rows: Int[np.ndarray, " rows"]) -> str:
    return table.row_name(table.first_row + int(rows[0]))


def rows_are(count: int) -> str:
    return "1 row is" if count == 1 else f"{count} rows are"


def places_of(count: int) -> str:
    return "1 place" if count == 1 else f"{count} places"
