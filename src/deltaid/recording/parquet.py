"""Reading Parquet in slices."""

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.recording.columns import Channel
from deltaid.recording.numbers import to_si
from deltaid.recording.source import Table, readable, require_numbers

SIGNATURE = b"PAR1"
# Several slices share a row group, of which each decodes more than its own rows.
_SLICE_ROWS = 1 << 17


def open_parquet(path: Path) -> Table:
    """The header of a Parquet file.

    Raises:
        RecordingError: it is none, or is damaged.
    """
    with readable(path):
        return Table(path, tuple(_scan(path).collect_schema()))


def read_parquet(
    table: Table, channels: tuple[Channel, ...]
) -> Iterator[Float[np.ndarray, "rows channels"]]:
    """Rows in SI units.

    Raises:
        RecordingError: a column does not hold numbers, or one of them is not finite.
    """
    with readable(table.path):
        frame = _scan(table.path).select([channel.column for channel in channels])
        require_numbers(table, frame)
    row = table.first_row
    while True:
        with readable(table.path), _silent_panics():
            part = frame.slice(row - table.first_row, _SLICE_ROWS).collect()
            numbers = [series.cast(pl.Float64, strict=False) for series in part]
        if not part.height:
            return
        yield to_si(table, channels, numbers, numbers, row)
        row += part.height


def _scan(path: Path) -> pl.LazyFrame:
    return pl.scan_parquet(path, glob=False, hive_partitioning=False)


@contextmanager
def _silent_panics() -> Generator[None, None, None]:
    """Keep standard error clean while polars decodes.

    Over a damaged file its threads panic, and each reports that on file descriptor 2 before an
    exception with the reason arrives here.
    """
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
