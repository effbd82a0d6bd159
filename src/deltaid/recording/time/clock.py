"""Clock of a recording: the times of its rows."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.recording.masks.masks import Runs

# Highest sampling rate [Hz]; a higher one is due to a wrong unit of time.
HIGHEST_RATE = 1e6
NO_TIME = (
    "map the column of the time with --columns MAPPING.yaml (time: {column: NAME}), or give the "
    "sampling rate in its place (time: {rate: 1000})"
)
# Largest jitter that is not reported [periods, rms].
JITTER = 0.01


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of the rows of a recording, which are counted from 0.

    Attributes:
        period: time between two samples [s].
        rows: number of rows of the recording.
        steady: whether no row is missing and stamps are even, so that rows are used unchanged.
        even: whether samples were taken evenly, whatever their stamps; None if the motion is too
            slow to show it (samples then count as even).
        jitter: jitter of the stamps against the even grid [s, rms]; 0 if steady.
        wild, first_wild: number of rows excluded for stamps far off their neighbours, and the first
            such row; −1 without any.
        extra: all excluded rows.
        doubled, late: numbers of excluded rows that repeat the row before them, and of those that
            have no place on the grid.
        holes: rows before which rows are missing or time restarts.
        lost: number of rows missing in each hole; −1 if time restarts.
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
        """Clock with runs of rows excluded as holes before the rows that follow."""
        if not len(runs):
            return self
        removed = np.concatenate([np.arange(first, last + 1) for first, last in runs])
        extra = np.union1d(self.extra, removed)
        holes = np.stack([self.holes, self.lost, self.since, self.until], axis=1)
        remaining = np.append(np.delete(np.arange(self.rows), extra), self.rows)
        for first, last in runs:
            after = int(remaining[np.searchsorted(remaining, last)])
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
        """Whether each hole ends a segment: it is too long to bridge, or time restarts.

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
        """Report on the clock, for programs.

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
    """Report on the clock of a recording, for programs.

    Attributes:
        rate_hz: sampling rate [Hz].
        steady: whether no row is missing and stamps are even.
        even: whether samples were taken evenly, whatever their stamps; None if the motion is too
            slow to show it. Uneven samples are interpolated.
        jitter_s: jitter of the stamps against the even grid [s, rms].
        wild, doubled, out_of_place: numbers of rows excluded because their stamps are far off their
            neighbours, because they repeat the row before, or because they are late.
        bridged: number of missing rows in short holes, which are interpolated.
        gaps: start and end [s] of holes that end a segment.
        restarts: number of times that time restarts.
        segments: number of segments that are long enough for the filter.
        too_short: share of the samples in shorter segments.
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
