"""What the tables of a fleet's folder say of earlier calls, so that nothing is done again."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleet.fits import PARAMETERS
from deltaid.fleet.fits import SCHEMA as PARAMETERS_SCHEMA
from deltaid.fleet.fleet import Absent, Recorded
from deltaid.fleet.gathering import Outcome
from deltaid.fleet.place import Place
from deltaid.fleet.studies import TABLES as STUDY_TABLES
from deltaid.fleet.types import TABLES as TYPE_TABLES

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
        recordings: rows of the table of recordings that have factors, by their keys.
        refused: reasons, by key.
        tables: rows of fits, by table.
    """

    recordings: Mapping[str, Mapping[str, object]]
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
        rows = () if table is None else table.iter_rows(named=True)
        schemas = {PARAMETERS: PARAMETERS_SCHEMA, **STUDY_TABLES, **TYPE_TABLES}
        tables = {name: place.table(f"{name}.parquet") for name in schemas}
        for name, found, schema in (
            (RECORDINGS, table, RECORDINGS_SCHEMA),
            *((f"{name}.parquet", tables[name], schemas[name]) for name in schemas),
        ):
            if found is not None and found.schema != pl.Schema(schema):
                raise DeltaidError(
                    "has other columns than this version writes",
                    where=place.at(name),
                    cure="remove it; it is made again from the factor files",
                )
        return cls(
            {row["key"]: row for row in rows if row["file"]},
            {} if retry else _refused(place),
            {name: one for name, one in tables.items() if one is not None},
        )

    def gathered(self, recorded: Recorded, key: str, listing: Mapping[str, int]) -> Outcome | None:
        """What became of a recording in an earlier call, if its factors are still there whole."""
        if key in self.refused:
            return Outcome(recorded, key, reason=self.refused[key], is_new=False)
        row = self.recordings.get(key)
        if row is None or listing.get(str(row["file"])) != row["bytes"]:
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
        for row in self.recordings.values():
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
