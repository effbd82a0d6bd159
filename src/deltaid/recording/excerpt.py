"""Rows of a log in memory: all of a short one, of a long one stretches that stand for all of it.

What a recording lacks or has too much of (a lag, a law of friction, a gear that gives way) shows in
a minute of it as in an hour. So a log is read once more for stretches that are spread evenly from
its beginning to its end, and whoever has to look at rows again and again looks at these.

Reading text takes more than all else, so the rows of a log that is not too long are kept.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.recording.columns import Columns, Rows
from deltaid.recording.filter import LowPass
from deltaid.recording.table import Batch
from deltaid.recording.windows import WINDOW

# So many stretches, of so many windows and seconds together; no more than so many windows.
_STRETCHES, _WINDOWS, _SECONDS, _MOST = 4, 3, 24.0, 32
# A stretch is so many times as long as the filter at least.
_LONG = 8
# A log that is no longer than so many times an excerpt is held as it is.
_WHOLE = 2.0
# Numbers that are kept at most: 128 MiB, or two million rows of four drives' positions and torques.
_MOST_NUMBERS = 1 << 24


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Evenly spaced rows of a log.

    Attributes:
        columns: what stands where, as in `Log.segments`; weights follow.
        stretches: without a gap.
        whole: whether they are all of it.
    """

    columns: Columns
    stretches: tuple[Rows, ...]
    whole: bool

    def segments(self, columns: Columns) -> Iterator[Iterator[Rows]]:
        """The stretches with some of their columns."""
        places, own = places_among(self.columns, columns), len(self.columns.all)
        for rows in self.stretches:
            if places is not None:
                rows = rows[:, [*places, *range(own, rows.shape[1])]]
            yield iter((rows,))


def excerpt(
    segments: Iterable[Iterable[Rows]],
    columns: Columns,
    samples: int,
    rate: float,
    low_pass: LowPass,
) -> Excerpt:
    """Stretches of a log; of a short one all of it.

    Args:
        segments: of the log, one after the other.
        columns: what stands where.
        samples: how many rows there are.
        rate: rows per second.
        low_pass: the recording's filter, which takes its length off both ends of a stretch.
    """
    lost = low_pass.reach
    wanted = min(max(_WINDOWS * WINDOW, round(_SECONDS * rate)), _MOST * WINDOW)
    count = max(1, min(_STRETCHES, wanted // max(1, _LONG * lost)))
    length = -(-wanted // count) + lost
    if samples <= _WHOLE * count * length:
        parts = (list(segment) for segment in segments)
        return Excerpt(columns, tuple(np.concatenate(x) for x in parts if x), whole=True)
    starts = np.linspace(0, samples - length, count).astype(int)
    return Excerpt(columns, tuple(_cut(segments, starts.tolist(), length)), whole=False)


def _cut(segments: Iterable[Iterable[Rows]], starts: Sequence[int], length: int) -> Iterator[Rows]:
    """Stretches from some rows on, shorter where a segment ends."""
    row, waiting = 0, list(starts)
    for segment in segments:
        parts: list[Rows] = []
        for rows in segment:
            while waiting and rows.size:
                first = waiting[0] - row
                part = rows[max(0, first) : max(0, first + length)]
                if len(part):
                    parts.append(part.copy())
                if first + length > len(rows):
                    break
                yield np.concatenate(parts)
                parts, waiting = [], waiting[1:]
            row += len(rows)
        if parts:
            yield np.concatenate(parts)


class Kept:
    """Takes down batches as they are read for the first time.

    Args:
        columns: of the batches.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns, self._left = columns, _MOST_NUMBERS
        self._batches: list[Batch] = []

    def taking(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """The batches, each taken down before it is handed on."""
        for batch in batches:
            self._left -= batch.values.size
            if self._left < 0:
                self._batches.clear()
            else:
                values = batch.values.copy()
                values.flags.writeable = False
                self._batches.append(Batch(batch.row, values))
            yield batch

    @property
    def whole(self) -> bool:
        """Whether they were few enough."""
        return self._left >= 0

    def read(self, columns: Columns) -> Iterator[Batch]:
        """All batches with some of their columns."""
        places = places_among(self._columns, columns)
        for batch in self._batches:
            yield batch if places is None else Batch(batch.row, batch.values[:, places])


def places_among(columns: Columns, some: Columns) -> np.ndarray | None:
    """Where channels of some columns stand among others; None if they are all of them."""
    places = [columns.all.index(channel) for channel in some.all]
    return None if len(places) == len(columns.all) else np.array(places)
