"""The time column of a recording: increasing, no gaps, evenly spaced, at a rate that can be."""

from dataclasses import dataclass

import numpy as np

from deltaid.errors import RecordingError
from deltaid.recording.filter import lowest_rate
from deltaid.recording.source import Table
from deltaid.recording.table import Batch

# A time step this much longer than the usual one is a gap; one this far off it is jitter.
_GAP, _JITTER = 1.5, 0.05
# No drive is sampled faster [Hz]; a higher rate is a wrong unit of time.
_HIGHEST_RATE = 1e6
# Time that hardly moves between two rows [s].
_SHORTEST_STEP = 1e-12


@dataclass
class ClockCheck:
    """Running check of consecutive rows.

    Attributes:
        table, column: the log, and which of its columns is the time.
        samples: rows so far.
        step: the usual time between two rows, a median [s].
        first_time, last_time: of the rows so far [s].
        jitter, first_jitter: steps that are uneven, and where the first one is.
    """

    table: Table
    column: str
    samples: int = 0
    step: float = 0.0
    first_time: float = np.nan
    last_time: float = np.nan
    jitter: int = 0
    first_jitter: str = ""

    @property
    def rate(self) -> float:
        """Sampling rate over the whole log [Hz]."""
        return (self.samples - 1) / (self.last_time - self.first_time)

    def add(self, batch: Batch) -> None:
        """Take in consecutive rows.

        Raises:
            RecordingError: time does not increase, or there is a gap.
        """
        time, name = batch.values[:, 0], self.column
        steps = np.diff(time, prepend=self.last_time)
        known = steps[~np.isnan(steps)]
        if not self.step and known.size:
            self.step = float(np.median(known))
        if not self.samples:
            self.first_time = float(time[0])
        self.last_time = float(time[-1])
        back = np.flatnonzero(steps < _SHORTEST_STEP)
        if back.size:
            i = int(back[0])
            before = time[i] - steps[i]
            raise RecordingError(
                f"time does not increase: {name} is {time[i]:.10g} s after {before:.10g} s",
                where=self.table.row_place(batch.row + i),
                cure="sort the rows, drop repeated ones, record time with more digits, or split "
                "the log where it restarts",
            )
        gaps = np.flatnonzero(steps > _GAP * self.step)
        if gaps.size:
            i = int(gaps[0])
            raise RecordingError(
                f"there is a gap of {steps[i]:.6g} s in {name} where {self.step:.6g} s is usual",
                where=self.table.row_place(batch.row + i),
                cure="split the log at the gap and give both parts as separate logs",
            )
        uneven = np.flatnonzero(np.abs(steps - self.step) > _JITTER * self.step)
        if uneven.size and not self.jitter:
            self.first_jitter = f"row {batch.row + int(uneven[0])}"
        self.jitter += uneven.size
        self.samples += len(time)

    def require_rate(self, *, differentiated: bool) -> None:
        """Refuse a rate at which nothing is sampled, or positions cannot be differentiated.

        Raises:
            RecordingError: with what can be.
        """
        slow = differentiated and self.rate < lowest_rate()
        if slow or self.rate > _HIGHEST_RATE:
            limit = f"at least {lowest_rate():g}" if slow else f"at most {_HIGHEST_RATE:g}"
            raise RecordingError(
                f"column {self.column} makes a sampling rate of {self.rate:.4g} Hz; "
                f"{limit} Hz can be",
                where=str(self.table.path),
                cure="declare the unit of time with --columns MAPPING.yaml (time: {column: "
                f"{self.column}, unit: ms}}), or record faster",
            )

    @property
    def warnings(self) -> list[str]:
        """What is doubtful."""
        if not self.jitter:
            return []
        return [
            f"{self.jitter} time steps differ by more than {100 * _JITTER:.0f} % from the usual "
            f"{self.step:g} s, the first in {self.first_jitter}; taken as evenly spaced"
        ]
