"""Factor files: one small Parquet file a recording.

A row of the table is one drive's triangle for one group of samples. That of all samples keeps every
bit, and so does what tolerances do; those of stretches and places, which only tell how far to trust
the rest, keep seven digits.
What stands beside them is JSON under the key `deltaid` of the file's metadata.
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float
from pydantic import ValidationError

from deltaid.errors import DeltaidError, RecordingError
from deltaid.factors.condensed import Condensed, Group
from deltaid.factors.record import FORMAT, FactorRecord
from deltaid.files import write_bytes

ENDING = ".factors.parquet"
_KEY, _FROM = "deltaid", "deltaid_from"
_EXACT = ("whole", "geometry")
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
            packed, exact = _packed(R), group.name in _EXACT
            rows.append(
                (group.name, i, group.samples[i], group.torque_max[i],
                 packed if exact else None, None if exact else packed.astype(np.float32))
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
    drives, groups = len(record.felt), dict[str, Group]()
    sizes = [len(own) + 1 for own in record.felt]
    for k in range(0, len(table), drives):
        part = table[k : k + drives]
        names = part["group"].unique().to_list()
        if len(names) != 1 or part["drive"].to_list() != list(range(drives)):
            raise RecordingError("has lost some of its rows", where=where, cure=_CURE)
        (name,) = names
        packed = part["exact" if name in _EXACT else "rounded"].to_list()
        more = len(record.quantities) if name == "geometry" else 0
        factors = tuple(_unpacked(x, n + more, where) for x, n in zip(packed, sizes, strict=True))
        groups[name] = Group(
            name, factors, part["samples"].to_numpy(), part["torque_max"].to_numpy()
        )
    whole, geometry = groups.pop("whole", None), groups.pop("geometry", None)
    if whole is None or (geometry is None) != (not record.quantities):
        raise RecordingError("has lost some of its rows", where=where, cure=_CURE)
    felt = tuple(np.array(own, dtype=int) for own in record.felt)
    return Condensed(record.names, felt, whole, tuple(groups.values()), geometry)


def _packed(R: Float[np.ndarray, "rank n"]) -> Float[np.ndarray, " packed"]:
    """The upper triangle row by row; rows beyond the rank are zero."""
    n = R.shape[1]
    square = np.zeros((n, n))
    square[: len(R)] = R
    return square[np.triu_indices(n)]


def _unpacked(packed: list[float] | None, n: int, where: str) -> Float[np.ndarray, "n n"]:
    if packed is None or len(packed) != n * (n + 1) // 2:
        raise RecordingError("has lost some of its numbers", where=where, cure=_CURE)
    square = np.zeros((n, n))
    square[np.triu_indices(n)] = packed
    if not np.all(np.isfinite(square)):
        raise RecordingError("holds numbers that are not finite", where=where, cure=_CURE)
    return square
