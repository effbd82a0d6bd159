"""Fields of a log as SI numbers, or the row and column of the first one that is none."""

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import RecordingError
from deltaid.recording.columns import Channel
from deltaid.recording.source import Table


def to_si(
    table: Table,
    channels: tuple[Channel, ...],
    numbers: list[pl.Series],
    texts: list[pl.Series],
    row: int,
) -> Float[np.ndarray, "rows channels"]:
    """Numbers of consecutive rows in SI units.

    Args:
        table, channels: the log and its columns.
        numbers: one series a channel, null where a field is not a number.
        texts: the same fields as they stand in the file.
        row: the first row.

    Raises:
        RecordingError: one of them is not finite; names the first such row.
    """
    values = np.empty((len(numbers[0]), len(channels)), order="F")
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (channel, series) in enumerate(zip(channels, numbers, strict=True)):
            np.subtract(series.to_numpy(), channel.zero, out=values[:, k])
            if channel.scale != 1:
                values[:, k] *= channel.scale
    finite = np.isfinite(values)
    if not finite.all():
        i, k = (int(index) for index in np.argwhere(~finite)[0])
        if table.separator and row + i == table.first_row and not finite[0].any():
            raise _row_of_units(table)
        raise _bad_value(table, channels[k], texts[k][i], row + i)
    return values


def _row_of_units(table: Table) -> RecordingError:
    return RecordingError(
        "holds no numbers, as if it were a row of units",
        where=table.row_place(table.first_row),
        cure=f"delete the row, or give --columns a mapping with data_row: {table.first_row + 1}, "
        "and declare the units there",
    )


def _bad_value(table: Table, channel: Channel, value: object, row: int) -> RecordingError:
    text = "" if value is None else "".join(c if c.isprintable() else "?" for c in str(value))
    what = f"is '{text[:40]}', not a finite number" if text else "is empty"
    cure = "remove or repair such rows; deltaid does not fill gaps"
    if "," in text and table.separator == ",":
        cure = "decimal commas need semicolons or tabs between the columns"
    elif table.separator and ("," in text or "." in text):
        cure = "write all numbers alike, with decimal point or decimal comma, and no thousands sign"
    return RecordingError(f"column {channel.column} {what}", where=table.row_place(row), cure=cure)
