"""Fields of a log as SI numbers, or the row and column of the first one that is none."""

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.columns import Channel, Columns
from deltaid.recording.source import Column, Rows, Table
from deltaid.recording.time.unwrap import Unwrapping

# How states are written as text.
_TRUE, _FALSE = ("true", "on"), ("false", "off")
# Numbers of sensors beyond this stand for nothing, such as the 1e38 of some loggers.
_LARGEST = 1e12


def to_si(
    table: Table, columns: Columns, rows: Rows, row: int, unwrapping: Unwrapping
) -> Float[np.ndarray, "rows channels"]:
    """Consecutive rows in SI units.

    Args:
        table, columns: the log and its columns.
        rows: the numbers of all of these columns.
        row: the first row.
        unwrapping: what makes counters and angles go on that start again.

    Where a sensor has no number, or one that no sensor shows, there is NaN.

    Raises:
        RecordingError: one of them is not finite; names the first such row.
    """
    channels = columns.all
    values = np.empty((rows.size, len(channels)), order="F")
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (channel, numbers) in enumerate(zip(channels, rows.numbers, strict=True)):
            # A null becomes NaN.
            array = numbers.to_numpy() if isinstance(numbers, pl.Series) else numbers
            if unwrapper := unwrapping.of(k):
                array = unwrapper.add(np.asarray(array, dtype=np.float64), row)
            if k >= columns.sensor_places.stop:
                array = _states(array, rows.written[k])
            np.subtract(array, channel.zero, out=values[:, k])
            if channel.scale != 1:
                values[:, k] *= channel.scale
    shown = values[:, columns.sensor_places]
    shown[~(np.abs(shown) <= _LARGEST)] = np.nan
    finite = np.isfinite(values)
    finite[:, columns.sensor_places] = True
    if not finite.all():
        i, k = (int(index) for index in np.argwhere(~finite)[0])
        raise _bad_value(table, channels[k], rows.written[k][i], row + i)
    return values


def _states(numbers: np.ndarray, written: Column) -> Float[np.ndarray, " rows"]:
    """Numbers of a column beside the drives, with 1 and 0 where true and false stand as text."""
    if not isinstance(written, pl.Series) or written.dtype != pl.String:
        return np.asarray(numbers, dtype=np.float64)
    text = written.str.strip_chars().str.to_lowercase()
    values = np.array(numbers, dtype=np.float64)
    for states, number in ((_TRUE, 1.0), (_FALSE, 0.0)):
        values[text.is_in(states).fill_null(False).to_numpy()] = number
    return values


def _bad_value(table: Table, channel: Channel, value: object, row: int) -> RecordingError:
    text = "" if value is None else "".join(c if c.isprintable() else "?" for c in str(value))
    what = f"is '{text[:40]}', not a finite number" if text else "is empty"
    return RecordingError(
        f"column {channel.column} {what}", where=table.row_place(row), cure=table.cure(text)
    )
