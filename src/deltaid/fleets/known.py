"""What the tables of a fleet's folder say of earlier calls, so that nothing is done again."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_one import GatherResult
from deltaid.fleets.place import Place

RECORDINGS, QUARANTINE = "recordings.parquet", "quarantine.csv"
RECORDINGS_SCHEMA = {
    "robot": pl.String,
    "type": pl.String,
    "time": pl.Datetime("us"),
    "path": pl.String,
    "columns": pl.String,
    "load": pl.Float64,
    "temperature": pl.Float64,
    "file": pl.String,
    "reason": pl.String,
    "samples": pl.Int64,
    "verdicts": pl.String,
    "sha256": pl.String,
    "bytes": pl.Int64,
    "key": pl.String,
    "how": pl.String,
    "there": pl.Boolean,
}
# Columns that are fields of the recording and of its outcome.
_RECORDED = ("robot", "type", "time", "path", "columns", "load", "temperature")
_OUTCOME = ("file", "reason", "samples", "verdicts", "sha256", "key")
_QUARANTINE = ("what", "robot", "which", "reason", "key")


@dataclass(frozen=True)
class Quarantined:
    """A line of the quarantine.

    Attributes:
        what: 'recording', 'fit', 'drift', 'type'.
        robot: whose.
        which: path, period or type.
        reason: in words.
        key: of what it follows from; empty where it is tried again at the next call.
    """

    what: str
    robot: str
    which: str
    reason: str
    key: str = ""


@dataclass(frozen=True)
class EarlierCalls:
    """What is known from earlier calls.

    Attributes:
        recordings: that have factors.
        rows: which row of these has a key.
        refused: reasons, by key.
        tables: of all steps, by name.
    """

    recordings: pl.DataFrame
    rows: Mapping[str, int]
    refused: Mapping[str, str]
    tables: Mapping[str, pl.DataFrame]

    @classmethod
    def read(
        cls, place: Place, schemas: Mapping[str, Mapping[str, Any]], *, retry: bool
    ) -> "EarlierCalls":
        """What the tables in a folder hold.

        Args:
            schemas: columns of the steps' tables, by name.
            retry: forget what was refused.

        Raises:
            DeltaidError: a table cannot be read.
        """
        table = place.table(RECORDINGS)
        tables = {name: place.table(f"{name}.parquet") for name in schemas}
        if table is not None and table.schema != pl.Schema(RECORDINGS_SCHEMA):
            raise DeltaidError(
                "has other columns than this version writes",
                where=place.path_to(RECORDINGS),
                cure="remove it, and it is made again; recordings that have been thrown away since "
                "are then forgotten",
            )
        used = pl.DataFrame(schema=RECORDINGS_SCHEMA) if table is None else table
        used = used.filter(pl.col("file") != "")
        return cls(
            used,
            {key: k for k, key in enumerate(used["key"])},
            {} if retry else _refused(place),
            {  # what another version has written is made again
                name: frame
                for name, frame in tables.items()
                if frame is not None and frame.schema == pl.Schema(schemas[name])
            },
        )

    def keys(self, name: str) -> frozenset[str]:
        """What rows of a table follow from."""
        return frozenset(self.tables[name]["key"]) if name in self.tables else frozenset()

    def with_new(
        self,
        name: str,
        schema: Mapping[str, Any],
        keys: Sequence[str],
        new: Mapping[str, pl.DataFrame],
    ) -> pl.DataFrame:
        """A table of rows that follow from some keys, in the order of these.

        Args:
            new: rows that this call has found, by key; all others are of earlier calls.
        """
        order = pl.DataFrame({"key": list(dict.fromkeys(keys))}, schema={"key": pl.String})
        old = self.tables.get(name, pl.DataFrame(schema=schema))
        kept = old.filter(~pl.col("key").is_in(list(new)))
        rows = pl.concat([kept, *(new[key] for key in keys if key in new)])
        ordered = order.join(rows, on="key", how="inner", maintain_order="left_right")
        return ordered.select(*schema)

    def gathered(
        self, recorded: Recorded, key: str, listing: Mapping[str, int]
    ) -> GatherResult | None:
        """What became of a recording in an earlier call, if its factors are still there whole."""
        if key in self.refused:
            return GatherResult(recorded, key, reason=self.refused[key], is_new=False)
        if key not in self.rows:
            return None
        row = self.recordings.row(self.rows[key], named=True)
        if listing.get(row["file"]) != row["bytes"]:
            return None
        return _outcome(recorded, row)

    def gone(
        self, here: Set[str], listing: Mapping[str, int]
    ) -> Iterator[tuple[GatherResult, str]]:
        """What became of recordings that are not `here` and whose factors are still there whole,
        each with the checksum of how it was gathered."""
        for row in self.recordings.iter_rows(named=True):
            if row["path"] not in here and listing.get(row["file"]) == row["bytes"]:
                recorded = Recorded(**{key: row[key] for key in _RECORDED})
                yield _outcome(recorded, row), row["how"]


def recordings_table(outcomes: Sequence[GatherResult], how: Mapping[Recorded, str]) -> pl.DataFrame:
    """One row a recording."""
    rows = [
        {key: getattr(outcome.recorded, key) for key in _RECORDED}
        | {key: getattr(outcome, key) for key in _OUTCOME}
        | {
            "bytes": outcome.size,
            "how": how.get(outcome.recorded, ""),
            "there": bool(outcome.recorded.stamp),
        }
        for outcome in outcomes
    ]
    return pl.DataFrame(rows, schema=RECORDINGS_SCHEMA, orient="row")


def quarantine_csv(lines: Sequence[Quarantined]) -> bytes:
    """The quarantine as CSV."""
    rows = [tuple(getattr(line, name) for name in _QUARANTINE) for line in lines]
    frame = pl.DataFrame(rows, schema=dict.fromkeys(_QUARANTINE, pl.String), orient="row")
    return frame.write_csv().encode()


def _outcome(recorded: Recorded, row: Mapping[str, Any]) -> GatherResult:
    known: dict[str, Any] = {key: row[key] for key in _OUTCOME}
    return GatherResult(recorded, is_new=False, size=row["bytes"], **known)


def _refused(place: Place) -> dict[str, str]:
    """Reasons of what was refused and would be again, by key."""
    data = place.store.read(place.path_to(QUARANTINE))
    if not data:
        return {}
    try:
        table = pl.read_csv(BytesIO(data), infer_schema=False)
        reasons = table.select(pl.col("key").fill_null(""), "reason").rows()
    except pl.exceptions.PolarsError as error:
        raise DeltaidError(
            f"cannot be read: {str(error).splitlines()[0]}",
            where=place.path_to(QUARANTINE),
            cure="remove it; it is made again",
        ) from None
    return {key: reason for key, reason in reasons if key}
