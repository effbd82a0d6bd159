"""What the tables of a fleet's folder say of earlier calls, so that nothing is done again."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import astuple, dataclass, fields
from io import BytesIO
from typing import Any

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.fleet import Quarantined, Recorded
from deltaid.fleets.gather_plan import GatherJob
from deltaid.fleets.place import Place

RECORDINGS, QUARANTINE = "recordings.parquet", "quarantine.csv"
# Folder of the tables as they were before a call.
BEFORE = "before"
_PUT_BACK = (
    f"put {BEFORE}/{RECORDINGS} in its place; if you remove it, recordings that are away are "
    "forgotten"
)
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
_OUTCOME = ("file", "reason", "samples", "verdicts", "sha256", "key", "how")


@dataclass(frozen=True)
class GatherResult:
    """What became of one recording.

    Attributes:
        recorded: which.
        key: checksum of what its factors follow from; empty where another call may end otherwise.
        file: its factor file, seen from the fleet's folder; empty if it was refused.
        reason: why it is in quarantine; empty if it is not.
        is_new: whether it was looked at now.
        size: of the factor file [bytes].
        sha256: of the recording.
        samples: of the recording.
        verdicts: of its checks that are not good, by name.
        how: checksum of how it is gathered; empty where it cannot be.
    """

    recorded: Recorded
    key: str
    file: str = ""
    reason: str = ""
    is_new: bool = True
    size: int = 0
    sha256: str = ""
    samples: int = 0
    verdicts: str = ""
    how: str = ""


@dataclass(frozen=True)
class EarlierCalls:
    """What is known from earlier calls.

    Attributes:
        recordings: that have factors.
        rows: which row of these has a key.
        hows: how a recording was gathered, by its path.
        refused: reasons, by key.
        tables: of all steps, by name.
    """

    recordings: pl.DataFrame
    rows: Mapping[str, int]
    hows: Mapping[str, str]
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
        table = place.table(RECORDINGS, _PUT_BACK)
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
            dict(zip(used["path"], used["how"], strict=True)),
            {} if retry else _refused(place),
            {  # what another version has written is made again
                name: pl.DataFrame(schema=schemas[name])
                if frame is None or frame.schema != pl.Schema(schemas[name])
                else frame
                for name, frame in tables.items()
            },
        )

    def with_new(
        self, name: str, keys: Sequence[str], new: Mapping[str, pl.DataFrame]
    ) -> pl.DataFrame:
        """A table of rows that follow from some keys, in the order of these.

        Args:
            new: rows that this call has found, by key; all others are of earlier calls.
        """
        order = pl.DataFrame({"key": list(dict.fromkeys(keys))}, schema={"key": pl.String})
        old = self.tables[name]
        kept = old.filter(~pl.col("key").is_in(list(new)))
        rows = pl.concat([kept, *(new[key] for key in keys if key in new)])
        return order.join(rows, on="key", how="inner", maintain_order="left_right").select(
            old.columns
        )

    def gathered(self, job: GatherJob, listing: Mapping[str, int]) -> GatherResult | None:
        """What became of a recording in an earlier call, if its factors are still there whole."""
        if job.key in self.refused:
            reason, how = self.refused[job.key], job.how.digest
            return GatherResult(job.recorded, job.key, reason=reason, is_new=False, how=how)
        if job.key not in self.rows:
            return None
        row = self.recordings.row(self.rows[job.key], named=True)
        return _outcome(job.recorded, row) if listing.get(row["file"]) == row["bytes"] else None

    def gone(self, here: Set[str]) -> Iterator[GatherResult]:
        """What became of recordings that are not `here`."""
        for row in self.recordings.iter_rows(named=True):
            if row["path"] not in here:
                yield _outcome(Recorded(**{key: row[key] for key in _RECORDED}), row)


def recordings_table(outcomes: Sequence[GatherResult]) -> pl.DataFrame:
    """One row a recording."""
    rows = [
        {key: getattr(outcome.recorded, key) for key in _RECORDED}
        | {key: getattr(outcome, key) for key in _OUTCOME}
        | {"bytes": outcome.size, "there": bool(outcome.recorded.stamp)}
        for outcome in outcomes
    ]
    return pl.DataFrame(rows, schema=RECORDINGS_SCHEMA, orient="row")


def quarantine_table(lines: Sequence[Quarantined]) -> pl.DataFrame:
    """One row a line of the quarantine."""
    schema = dict.fromkeys((entry.name for entry in fields(Quarantined)), pl.String)
    return pl.DataFrame([astuple(line) for line in lines], schema=schema, orient="row")


def _outcome(recorded: Recorded, row: Mapping[str, Any]) -> GatherResult:
    known: dict[str, Any] = {key: row[key] for key in _OUTCOME}
    return GatherResult(recorded, is_new=False, size=row["bytes"], **known)


def _refused(place: Place) -> dict[str, str]:
    """Reasons of what was refused and would be again, by key."""
    data = place.read(QUARANTINE)
    if not data:
        return {}
    try:
        table = pl.read_csv(BytesIO(data), infer_schema=False)
        reasons = table.select(pl.col("key").fill_null(""), "reason").rows()
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise DeltaidError(
            f"cannot be read: {str(error).splitlines()[0]}",
            where=place.path_to(QUARANTINE),
            cure="remove it; it is made again",
        ) from None
    return {key: reason for key, reason in reasons if key}
