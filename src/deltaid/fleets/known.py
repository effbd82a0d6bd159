"""What the tables of a fleet's folder say of earlier calls, so that nothing is done again."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.fit_step import PARAMETERS
from deltaid.fleets.fit_step import SCHEMA as PARAMETERS_SCHEMA
from deltaid.fleets.fleet import Absent, Recorded
from deltaid.fleets.gather_one import Outcome
from deltaid.fleets.place import Place
from deltaid.fleets.study_step import TABLES as STUDY_TABLES
from deltaid.fleets.type_step import TABLES as TYPE_TABLES

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
class Named:
    """What the manifest names of a robot: paths, and patterns as regular expressions."""

    paths: frozenset[str]
    patterns: tuple[re.Pattern[str], ...]

    def has(self, path: str) -> bool:
        """Whether a path is among it."""
        return path in self.paths or any(one.fullmatch(path) for one in self.patterns)


@dataclass(frozen=True)
class Known:
    """What is known from earlier calls.

    Attributes:
        recordings: that have factors.
        rows: which row of these has a key.
        refused: reasons, by key.
        tables: of fits, by name.
    """

    recordings: pl.DataFrame
    rows: Mapping[str, int]
    refused: Mapping[str, str]
    tables: Mapping[str, pl.DataFrame]

    @classmethod
    def of(cls, place: Place, *, retry: bool) -> "Known":
        """Of a folder.

        Args:
            retry: forget what was refused.

        Raises:
            DeltaidError: a table cannot be read.
        """
        table = place.table(RECORDINGS)
        schemas = {PARAMETERS: PARAMETERS_SCHEMA, **STUDY_TABLES, **TYPE_TABLES}
        tables = {name: place.table(f"{name}.parquet") for name in schemas}
        if table is not None and table.schema != pl.Schema(RECORDINGS_SCHEMA):
            raise DeltaidError(
                "has other columns than this version writes",
                where=place.at(RECORDINGS),
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
                name: one
                for name, one in tables.items()
                if one is not None and one.schema == pl.Schema(schemas[name])
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
        order = {key: k for k, key in enumerate(keys)}
        old = self.tables.get(name, pl.DataFrame(schema=schema))
        kept = old.filter(pl.col("key").is_in([key for key in order if key not in new]))
        whole = pl.concat([kept, *(new[key] for key in order if key in new)])
        places = pl.DataFrame({"key": list(order), "order": list(order.values())},
                              schema={"key": pl.String, "order": pl.Int64})  # fmt: skip
        return (
            whole.join(places, on="key", how="left")
            .sort("order", maintain_order=True)
            .drop("order")
        )

    def gathered(self, recorded: Recorded, key: str, listing: Mapping[str, int]) -> Outcome | None:
        """What became of a recording in an earlier call, if its factors are still there whole."""
        if key in self.refused:
            return Outcome(recorded, key, reason=self.refused[key], is_new=False)
        if key not in self.rows:
            return None
        row = self.recordings.row(self.rows[key], named=True)
        if listing.get(str(row["file"])) != row["bytes"]:
            return None
        return _outcome(recorded, row)

    def gone(
        self, here: Sequence[Recorded], named: Mapping[str, Named], listing: Mapping[str, int]
    ) -> list[tuple[Recorded, Outcome, str]]:
        """Recordings that the manifest still names and that are no longer where they were.

        What they said has been kept, so they count: logs may be thrown away once gathered.

        Args:
            here: recordings that are there.
            named: by robot, what the manifest names.

        Returns:
            For each, as it was, and the checksum of how it was gathered.
        """
        there = {one.path for one in here}
        found = list[tuple[Recorded, Outcome, str]]()
        for row in self.recordings.iter_rows(named=True):
            path, robot = str(row["path"]), str(row["robot"])
            still = robot in named and named[robot].has(path)
            if path in there or not still or listing.get(str(row["file"])) != row["bytes"]:
                continue
            recorded = Recorded(
                **{key: row[key] for key in ("robot", "time", "path", "type")},  # pyright: ignore
                columns=str(row["columns"]),
                load=row["load"],  # pyright: ignore
                temperature=row["temperature"],  # pyright: ignore
            )
            found.append((recorded, _outcome(recorded, row), str(row["how"])))
        return found


def recordings_table(outcomes: Sequence[Outcome], how: Mapping[Recorded, str]) -> pl.DataFrame:
    """One row a recording."""
    rows = [
        (one.recorded.robot, one.recorded.type, one.recorded.time, one.recorded.path,
         one.recorded.columns, one.recorded.load, one.recorded.temperature, one.file, one.reason,
         one.samples, one.verdicts, one.sha256, one.size, one.key, how.get(one.recorded, ""),
         bool(one.recorded.stamp))
        for one in outcomes
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=RECORDINGS_SCHEMA, orient="row")


def quarantine_csv(lines: Sequence[Quarantined]) -> bytes:
    """The quarantine as CSV."""
    rows = [tuple(getattr(line, name) for name in _QUARANTINE) for line in lines]
    frame = pl.DataFrame(rows, schema=dict.fromkeys(_QUARANTINE, pl.String), orient="row")
    return frame.write_csv().encode()


def absent_line(one: Absent) -> Quarantined:
    """What the manifest names and is not there."""
    return Quarantined("recording", one.robot, one.path, one.reason)


def _outcome(recorded: Recorded, row: Mapping[str, object]) -> Outcome:
    return Outcome(
        recorded,
        str(row["key"]),
        file=str(row["file"]),
        is_new=False,
        size=int(str(row["bytes"])),
        sha256=str(row["sha256"]),
        samples=int(str(row["samples"])),
        verdicts=str(row["verdicts"]),
    )


def _refused(place: Place) -> dict[str, str]:
    """Reasons of what was refused and would be again, by key."""
    data = place.store.read(place.at(QUARANTINE))
    if not data:
        return {}
    try:
        table = pl.read_csv(BytesIO(data), infer_schema=False)
        found = table.select(pl.col("key").fill_null(""), "reason").rows()
    except pl.exceptions.PolarsError as error:
        raise DeltaidError(
            f"cannot be read: {str(error).splitlines()[0]}",
            where=place.at(QUARANTINE),
            cure="remove it; it is made again",
        ) from None
    return {key: reason for key, reason in found if key}
