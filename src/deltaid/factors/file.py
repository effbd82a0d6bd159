"""Factor files: one small Parquet file a recording.

A row of the table is one drive's triangle for one group of samples. That of all samples keeps every
bit; those of stretches and places, and what tolerances do, which only tell how far to trust the
rest, keep seven digits.
What stands beside them is JSON under the key `deltaid` of the file's metadata.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
from pydantic import ValidationError

from deltaid.errors import DeltaidError, RecordingError
from deltaid.factors.condensed import Condensed, Groups, packed
from deltaid.factors.record import FORMAT, FactorRecord
from deltaid.files import write_bytes

ENDING = ".factors.parquet"
_KEY, _FROM = "deltaid", "deltaid_from"
_APART, _BESIDE = ("whole", "geometry"), ("samples", "torque_max")
_SCHEMA = {
    "group": pl.String,
    "drive": pl.Int32,
    "samples": pl.Float64,
    "torque_max": pl.Float64,
    "exact": pl.List(pl.Float64),
    "rounded": pl.List(pl.Float32),
}
_CURE = "gather the recording again with `deltaid gather`"


@dataclass(frozen=True, eq=False)
class FactorFile:
    """A recording's factors with what they rest on.

    Attributes:
        record: the latter.
        condensed: the former.
        path: of the file; empty for what has been gathered just now.
        key: a checksum of what it follows from.
    """

    record: FactorRecord
    condensed: Condensed
    path: str = ""
    key: str = ""


def is_factor_file(path: Path) -> bool:
    """Whether a file's name says that it holds factors."""
    return path.name.endswith(ENDING)


def write(found: FactorFile, path: Path, key: str = "") -> None:
    """Write a factor file, whole or not at all.

    Args:
        key: a checksum of what it follows from.

    Raises:
        DeltaidError: it cannot be written.
    """
    condensed, rows = found.condensed, []
    geometry = [] if condensed.geometry is None else [condensed.geometry]
    for group in (condensed.whole, *geometry, *condensed.groups):
        for i, R in enumerate(group.factors):
            row, exact = packed(R), group is condensed.whole
            rows.append(
                (group.name, i, group.samples[i], group.torque_max[i],
                 row if exact else None, None if exact else row.astype(np.float32))
            )  # fmt: skip
    table, buffer = pl.DataFrame(rows, schema=_SCHEMA, orient="row"), BytesIO()
    table.write_parquet(
        buffer, compression="zstd", metadata={_KEY: found.record.model_dump_json(), _FROM: key}
    )
    write_bytes(path, buffer.getvalue())


def read_key(path: Path) -> str | None:
    """The checksum of what a file follows from; None where there is no such file that is whole."""
    if not path.is_file():
        return None
    try:
        return read(path).key
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
        raise RecordingError(
            f"cannot be read as a factor file: {error}", where=where, cure=_CURE
        ) from None
    if table.schema != pl.Schema(_SCHEMA):
        raise RecordingError("is no factor file: its columns are others", where=where, cure=_CURE)
    record = _record(beside.get(_KEY), where)
    return FactorFile(record, _condensed(table, record, where), where, beside.get(_FROM, ""))


def _record(text: str | None, where: str) -> FactorRecord:
    if text is None:
        raise RecordingError("is no factor file", where=where, cure=_CURE)
    try:
        return FactorRecord.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise RecordingError(
            f"is a factor file that this version (format {FORMAT}) cannot use: {place}: "
            f"{first['msg']}",
            where=where,
            cure=_CURE,
        ) from None
    except DeltaidError as error:
        raise RecordingError(
            f"holds what cannot be: {error.what}", where=where, cure=_CURE
        ) from None


def _condensed(table: pl.DataFrame, record: FactorRecord, where: str) -> Condensed:
    names = table["group"].to_list()[:: len(record.felt)]
    grouped = table.group_by("group", maintain_order=True)
    every = list(range(len(record.felt)))
    if [row for _, row in grouped.agg("drive").iter_rows()] != [every] * len(names):
        raise RecordingError("has lost some of its rows", where=where, cure=_CURE)
    sizes = [len(own) + 1 for own in record.felt]
    parts = {
        name: _groups(part, [n + more for n in sizes], where)
        for name, part, more in (
            ("whole", table.filter(pl.col("group") == "whole"), 0),
            ("geometry", table.filter(pl.col("group") == "geometry"), len(record.quantities)),
            ("groups", table.filter(~pl.col("group").is_in(_APART)), 0),
        )
        if len(part)
    }
    if {*parts} != {"whole", "groups", *(["geometry"] if record.quantities else [])}:
        raise RecordingError("has lost some of its rows", where=where, cure=_CURE)
    felt = tuple(np.array(own, dtype=int) for own in record.felt)
    (whole,), geometry = parts["whole"], next(iter(parts.get("geometry", ())), None)
    return Condensed(record.names, felt, whole, parts["groups"], geometry)


def _groups(table: pl.DataFrame, sizes: list[int], where: str) -> Groups:
    """Some groups of a file."""
    drives, names = len(sizes), table["group"].to_list()[:: len(sizes)]
    packed_in = "exact" if names[0] == "whole" else "rounded"
    lengths = [n * (n + 1) // 2 for n in sizes]
    if table[packed_in].list.len().to_list() != lengths * len(names):
        raise RecordingError("has lost some of its numbers", where=where, cure=_CURE)
    numbers = table[packed_in].explode().to_numpy().reshape(len(names), sum(lengths))
    if not np.all(np.isfinite(numbers)):
        raise RecordingError("holds numbers that are not finite", where=where, cure=_CURE)
    beside = (table[key].to_numpy().reshape(len(names), drives) for key in _BESIDE)
    return Groups(tuple(names), tuple(sizes), numbers, *beside)
