"""A surveyed log: its contents and faults, and its rows, read again or from memory.

A minute of a recording shows model errors such as a lag, a friction law or a compliant gear as well
as an hour does. So stages that need rows repeatedly use an excerpt: stretches spread evenly over
the log, which is read once more for them.

Reading text dominates the run time, so rows of a log that is not too long stay in memory.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt
from deltaid.recording.columns import Columns, Rows
from deltaid.recording.filter import LowPass
from deltaid.recording.masks.masks import Mask, as_runs, left_out, within
from deltaid.recording.masks.stuck import bridged
from deltaid.recording.row_sample import RowSample, in_text
from deltaid.recording.source import LogTable
from deltaid.recording.table import read_batches
from deltaid.recording.time.clock import Clock
from deltaid.recording.time.doubts import doubts_about_holes
from deltaid.recording.time.signals import longest_hole, segments
from deltaid.recording.windows import WINDOW
from deltaid.shown import Shown

# Size of an excerpt: number of stretches, fewest windows, fewest seconds, most windows; and the
# windows that suffice to compare a signal or to determine a lag.
_STRETCHES, _WINDOWS, SECONDS, MOST_WINDOWS, FEW_WINDOWS = 4, 3, 24.0, 32, 8
# Least length of a stretch in lengths of the filter, one of which it loses.
_LONG = 8
# A log of up to this many lengths of an excerpt is its own excerpt.
_WHOLE = 2.0
# Most numbers kept in memory: 128 MiB, two million rows of four drives' positions and torques.
_MOST_NUMBERS = 1 << 24
# Longest stretch of stale rows that is bridged [s].
_HELD = 0.1
# `Log.suggested_cutoff`: multiple of the bandwidth, least cut-off [Hz], least periods in a segment.
_ABOVE, _AT_LEAST, _LEAST_PERIODS = 2.0, 12.0, 100.0


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Evenly spaced rows of a log.

    Attributes:
        columns: columns of the rows, as in `Log.segments`; weights follow.
        stretches: rows without a gap, stretch by stretch.
        whole: whether the excerpt is the whole log.
    """

    columns: Columns
    stretches: tuple[Rows, ...]
    whole: bool

    def read(self, columns: Columns) -> Iterator[Rows]:
        """Stretches with these columns and the weights only."""
        held, wanted = self.columns.all, columns.all
        places = [held.index(channel) for channel in wanted]
        for rows in self.stretches:
            behind = range(len(held), rows.shape[1])
            yield rows if len(wanted) == len(held) else rows[:, [*places, *behind]]


def _cut(segments: Iterable[Iterable[Rows]], starts: Sequence[int], length: int) -> Iterator[Rows]:
    """Stretches of `length` rows from each start, cut at the ends of segments."""
    row = 0
    for segment in segments:
        parts = {start: list[Rows]() for start in starts}
        for rows in segment:
            for start, held in parts.items():
                part = rows[max(0, start - row) : max(0, start - row + length)]
                if len(part):
                    held.append(part.copy())
            row += len(rows)
        yield from (np.concatenate(held) for held in parts.values() if held)


def keep_batches(batches: Iterable[Rows], kept: list[Rows], row: int) -> Iterator[tuple[int, Rows]]:
    """Number batches by their first rows, and copy each to `kept`.

    `kept` is emptied once the numbers are too many.
    """
    room = _MOST_NUMBERS
    for values in batches:
        room -= values.size
        if room < 0:
            kept.clear()
        else:
            kept.append(values.copy())
            kept[-1].flags.writeable = False
        yield row, values
        row += len(values)


@dataclass(frozen=True, repr=False)
class Log(Shown):
    """A surveyed recording.

    Attributes:
        table, columns: the file or table, and its columns by quantity.
        sha256: checksum of the file, or of the numbers in memory.
        samples: number of rows.
        clock: times of the rows, with missing and doubled rows and jitter.
        torque_max: largest |τ| of each drive [N m]; empty without torques.
        position_noise: standard deviation of each position's noise, encoder steps included [rad or
            m]; 0 if it is not visible.
        reach: lowest and highest coordinates of the platform [m].
        motion_cutoff: low-pass cut-off of positions by `SpectrumEstimate.cutoff` [Hz], between
            emergency stops.
        bandwidth: bandwidth of the motion by `SpectrumEstimate.bandwidth` [Hz], between them too.
        masks: rows that are excluded; none if all are kept.
        keep_all: whether nothing is excluded.
        warnings: doubts, with rows and columns.
        sample: of the rows, to compare recordings.
        other_rate: how a time column contradicts the rate that the mapping states; else empty.
        kept: rows as they were read; None if they are too many.
        held: an excerpt that is read in place of all rows; None to read all.
        path: path of the log, or the name of one in memory.
        rate: sampling rate [Hz].
        has_derivatives: whether velocities and accelerations are recorded.
    """

    table: LogTable
    columns: Columns
    sha256: str
    samples: int
    clock: Clock
    torque_max: Float[np.ndarray, " drives"]
    position_noise: Float[np.ndarray, " positions"]
    reach: Float[np.ndarray, "2 3"]
    motion_cutoff: float | None
    bandwidth: float | None
    masks: tuple[Mask, ...]
    keep_all: bool
    warnings: tuple[Doubt, ...]
    sample: RowSample
    other_rate: str = ""
    kept: Excerpt | None = field(default=None, compare=False)
    held: Excerpt | None = field(default=None, compare=False)

    @property
    def path(self) -> Path:
        return self.table.path

    @property
    def rows(self) -> str:
        """Numbers of some rows, to recognise copies and excerpts."""
        return in_text(self.sample)

    @property
    def rate(self) -> float:
        return self.clock.rate

    @property
    def has_derivatives(self) -> bool:
        return bool(self.columns.velocity and self.columns.acceleration)

    @property
    def suggested_cutoff(self) -> float | None:
        """Low-pass cut-off for the rows of a regression [Hz]; None if it is unknown.

        It is twice the motion's bandwidth, because torques have products of velocities, and at
        least 12 Hz for the steps of friction: higher frequencies are mostly noise, play and ringing
        of gears. It is high enough that a usual segment loses at most a sixteenth of its samples to
        the filter, and never above the cut-off of positions.
        """
        if self.motion_cutoff is None or self.bandwidth is None:
            return None
        segments = self.laid.segments(self.bridged(self.motion_cutoff))
        usual = np.sum(segments**2.0) / np.sum(segments) / self.rate
        return min(
            self.motion_cutoff, max(_ABOVE * self.bandwidth, _AT_LEAST, _LEAST_PERIODS / usual)
        )

    @cached_property
    def laid(self) -> Clock:
        """Clock with long stretches of stale rows as holes."""
        return self.clock.without(as_runs((mask.first, mask.last) for mask in self._stale(True)))

    def _stale(self, long: bool) -> list[Mask]:
        """Stretches of stale rows: the long ones, which are holes, or the short ones, which are
        bridged."""
        stale = (mask for mask in self.masks if mask.reason == "stale rows")
        return [mask for mask in stale if (mask.last - mask.first >= _HELD * self.rate) == long]

    def batches(self) -> Iterator[Rows]:
        """All rows in SI units: columns as in `Columns.all`, then one weight per drive.

        The weight of a drive's torque in a row is between 0 and 1; a log without torques has no
        weights. Short stretches of stale rows are bridged by a smooth motion. Sensors are NaN in
        rows that do not count for them.
        """
        spans = [left_out(self.masks, drive) for drive in range(len(self.columns.torque))]
        # Reasons for which rows or motion are wrong, so that sensors do not count either.
        reasons = ("stale rows", "emergency stop", "before a stop", "load changes")
        invalid = left_out(mask for mask in self.masks if mask.reason in reasons)
        row, read = 0, self.kept.read(self.columns) if self.kept else None
        batches = read or read_batches(self.table, self.columns)
        for block in bridged(batches, self._stale(False), self.columns.motion_places):
            rows = np.arange(row, row + len(block))
            excluded = [within(runs, rows) for runs in spans]
            values = np.column_stack([block, *(1.0 - lost for lost in excluded)])
            values[within(invalid, rows), self.columns.sensor_places] = np.nan
            yield values
            row += len(block)

    def segments(self, cutoff: float | None) -> Iterator[Iterator[Float[np.ndarray, "_ _"]]]:
        """Evenly spaced samples of each segment in blocks; columns as in `batches`.

        Args:
            cutoff: cut-off of the later low-pass [Hz]; holes that it does not resolve are bridged.
        """
        if self.held is not None:
            return (iter((rows,)) for rows in self.held.read(self.columns))
        return segments(self.batches(), self.laid, self.bridged(cutoff), self.columns)

    def excerpt(self, cutoff: float | None, low_pass: LowPass) -> Excerpt:
        """Excerpt of the log; the whole log if it is short.

        Args:
            cutoff: as in `segments`.
            low_pass: the recording's filter; each stretch loses its length.
        """
        lost, segments = low_pass.reach, self.segments(cutoff)
        wanted = min(max(_WINDOWS * WINDOW, round(SECONDS * self.rate)), MOST_WINDOWS * WINDOW)
        count = max(1, min(_STRETCHES, wanted // max(1, _LONG * lost)))
        length = -(-wanted // count) + lost
        if self.samples <= _WHOLE * count * length:
            parts = (list(segment) for segment in segments)
            return Excerpt(self.columns, tuple(np.concatenate(x) for x in parts if x), whole=True)
        starts = np.linspace(0, self.samples - length, count).astype(int).tolist()
        return Excerpt(self.columns, tuple(_cut(segments, starts, length)), whole=False)

    def bridged(self, cutoff: float | None) -> int:
        """Largest number of consecutive missing rows that are bridged at a cut-off [Hz]."""
        return longest_hole(self.rate, cutoff) if cutoff else 1

    def cut_at(self, cutoff: float | None, shortest: int) -> "Log":
        """Log with warnings about its holes at a cut-off [Hz].

        Args:
            shortest: fewest samples of a usable segment.

        Raises:
            RecordingError: no segment is usable.
        """
        if self.laid.steady:
            return self
        places = self.laid, self.table, self.columns.time.column
        doubts = doubts_about_holes(*places, self.bridged(cutoff), shortest)
        doubts = [doubt for doubt in doubts if doubt not in self.warnings]
        return replace(self, warnings=(*self.warnings, *doubts))
