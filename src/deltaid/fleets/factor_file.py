"""Factor files: one small Parquet file a recording.

A row of the table is one drive's triangle for one group of samples. That of all samples keeps every
bit; those of stretches, places and tolerances, which only determine uncertainty, keep seven digits.
All else is JSON under the key `deltaid` of the file's metadata.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
from pydantic import ValidationError

from deltaid.errors import DeltaidError, RecordingError
from deltaid.files import write_bytes
from deltaid.fleets.factor_record import (
    FORMAT,
    FactorGroups,
    FactorRecord,
    RecordingFactors,
    packed,
)

ENDING = ".factors.parquet"
_KEY, _FROM = "deltaid", "deltaid_from"
_SCHEMA = {
    "group": pl.String,
    "drive": pl.Int32,
    "samples": pl.Float64,
    "torque_max": pl.Float64,
    "exact": pl.List(pl.Float64),
    "rounded": pl.List(pl.Float32),
}


@dataclass(frozen=True, eq=False)
class FactorFile:
    """A recording's factors with what they rest on."""

    record: FactorRecord
    condensed: RecordingFactors
    path: str = ""  # of the file; empty for what has been gathered just now
    key: str = ""  # a checksum of what it follows from

    @property
    def where(self) -> str:
        """The file, or its recording, for messages."""
        return self.path or self.record.log


def is_factor_file(path: Path) -> bool:
    """Whether a file's name says that it holds factors."""
    return path.name.endswith(ENDING)


def write(file: FactorFile, path: Path, key: str = "") -> None:
    """Write a factor file, whole or not at all; `key` is a checksum of what it follows from. A
    DeltaidError says why it cannot be written."""
    condensed, rows = file.condensed, []
    geometry = [] if condensed.geometry is None else [condensed.geometry]
    for group in (condensed.whole, *geometry, *condensed.groups):
        for i, R in enumerate(group.factors):
            numbers = packed(R)
            exact = (numbers, None) if group is condensed.whole else (None, numbers.astype("f4"))
            rows.append((group.name, i, group.samples[i], group.torque_max[i], *exact))
    table, buffer = pl.DataFrame(rows, schema=_SCHEMA, orient="row"), BytesIO()
    table.write_parquet(
        buffer, compression="zstd", metadata={_KEY: file.record.model_dump_json(), _FROM: key}
    )
    write_bytes(path, buffer.getvalue())


def read_key(path: Path) -> str | None:
    """The checksum of what a file follows from; None where there is no such file that is whole."""
    try:
        return read(path).key if path.is_file() else None
    except RecordingError:
        return None


def read(path: Path) -> FactorFile:
    """Read a factor file.

    Raises:
        RecordingError: it is none, is damaged, or is of a later version.
    """
    where = str(path)
    try:
        beside, table = pl.read_parquet_metadata(path), pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise _refusal(f"cannot be read as a factor file: {error}", where) from None
    if table.schema != pl.Schema(_SCHEMA):
        raise _refusal("is no factor file: its columns are others", where)
    text = beside.get(_KEY)
    if text is None:
        raise _refusal("is no factor file", where)
    try:
        record = FactorRecord.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise _refusal(
            f"is a factor file that this version (format {FORMAT}) cannot use: {why}", where
        ) from None
    except DeltaidError as error:
        raise _refusal(f"holds what cannot be: {error.what}", where) from None
    return FactorFile(record, _condensed(table, record, where), where, beside.get(_FROM, ""))


def _refusal(reason: str, where: str) -> RecordingError:
    cure = "gather the recording again with `deltaid gather`"
    return RecordingError(reason, where=where, cure=cure)


def _condensed(table: pl.DataFrame, record: FactorRecord, where: str) -> RecordingFactors:
    drives, shifts = len(record.felt), len(record.quantities)
    single, names = ["whole", "geometry"][: 1 + bool(shifts)], table["group"].to_list()[::drives]
    rows = [(name, i) for name in names for i in range(drives)]
    whole_file = names[: len(single)] == single and len(names) > len(single)
    if not whole_file or table.select("group", "drive").rows() != rows:
        raise _refusal("has lost some of its rows", where)
    whole, geometry, rest = (table[drives * k :] for k in (0, 1, len(single)))
    sizes = tuple(len(places) + 1 for places in record.felt)
    wide = tuple(n + shifts for n in sizes)
    return RecordingFactors(
        record.names,
        tuple(np.array(places, dtype=int) for places in record.felt),
        next(iter(_groups(whole[:drives], sizes, "exact", where))),
        _groups(rest, sizes, "rounded", where),
        next(iter(_groups(geometry[:drives], wide, "rounded", where))) if shifts else None,
    )


def _groups(table: pl.DataFrame, sizes: tuple[int, ...], column: str, where: str) -> FactorGroups:
    names = tuple(table["group"].to_list()[:: len(sizes)])
    lengths = [n * (n + 1) // 2 for n in sizes]
    if table[column].list.len().to_list() != lengths * len(names):
        raise _refusal("has lost some of its numbers", where)
    numbers = table[column].explode().to_numpy().reshape(len(names), sum(lengths))
    if not np.all(np.isfinite(numbers)):
        raise _refusal("holds numbers that are not finite", where)
    beside = (table[key].to_numpy().reshape(len(names), -1) for key in ("samples", "torque_max"))
    return FactorGroups(names, sizes, numbers, *beside)
