"""Sensors that are recorded late put beside the motion that they belong to.

What a sensor shows is smooth, as the motion is, so it is interpolated between samples. Beyond the
ends of a segment it says nothing.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from deltaid.recording.columns import Columns
from deltaid.recording.delay import around
from deltaid.recording.table import recut

# Samples on either side that a value is interpolated from; rows put right at once.
_HALF, _AT_ONCE = 4, 8000

Rows = Float[np.ndarray, "_ _"]
# Columns of one sensor, and shares of the samples so many later.
Shift = tuple[slice, list[tuple[int, float]]]


def in_time(segment: Iterable[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
    """Rows of a segment with y(t + δ) of each sensor beside the motion at t, in constant memory.

    Args:
        segment: evenly spaced rows in blocks.
        columns: what stands where, and how late each sensor is.
        rate: rows per second.
    """
    shifts, start = list[Shift](), columns.sensor_places.start
    for sensor in columns.sensors:
        own = slice(start, start + len(sensor.channels))
        start = own.stop
        if sensor.delay:
            shifts.append((own, around(sensor.delay * rate, _HALF)))
    if not shifts:
        yield from segment
        return
    places = [by for _, at in shifts for by, _ in at]
    before, after = max(0, -min(places)), max(0, *places)
    padded = _padded(segment, before, after, columns.sensor_places)
    for wide in recut(padded, _AT_ONCE, before + after):
        count = len(wide) - before - after
        out = wide[before : before + count].copy()
        for own, at in shifts:
            out[:, own] = sum(share * wide[before + by :][:count, own] for by, share in at)
        yield out


def _padded(segment: Iterable[Rows], before: int, after: int, sensors: slice) -> Iterator[Rows]:
    """A segment with rows beyond its ends in which sensors show nothing."""
    last: Rows | None = None

    def beyond(row: Rows, times: int) -> Rows:
        rows = np.repeat(row, times, axis=0)
        rows[:, sensors] = np.nan
        return rows

    for block in segment:
        if last is None and len(block):
            yield beyond(block[:1], before)
        last = block if len(block) else last
        yield block
    if last is not None:
        yield beyond(last[-1:], after)
