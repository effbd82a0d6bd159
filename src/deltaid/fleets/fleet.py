"""A fleet from its manifest: robots, their types, and all of their recordings.

A manifest is YAML with a list of robots, or a table (CSV, Parquet) with one row per recording or
pattern. Recordings are local paths or addresses of any store that fsspec supports, such as
s3://plant/line1/*.parquet.
"""

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from io import BytesIO
from pathlib import Path
from typing import Annotated

import polars as pl
from pydantic import Field, field_validator

from deltaid.errors import DescriptionError, nearest, quoted
from deltaid.fleets.store import has_pattern, is_address, matching, read, stamps_of
from deltaid.model.options import Period
from deltaid.robot.load import catalogue, parse
from deltaid.robot.part import Part

_ISO = re.compile(r"\d{4}-\d{2}-\d{2}")
_TIMES = "must be written as 2026-01-31 or 2026-01-31T08:30"
_TABLES = (".csv", ".parquet")
# Columns of a table: the first two are required, the first four are text.
_COLUMNS = ("robot", "recording", "type", "columns", "time", "load", "temperature")


# The longest path of any system is Linux's.
_Path = Annotated[str, Field(min_length=1, max_length=4096)]


class RecordedFile(Part):
    """One recording, or several by a pattern."""

    path: Annotated[_Path, Field(description="path, address or pattern")]
    time: datetime | date | None = Field(
        default=None, description="when it was made; by default a date in its name"
    )
    columns: str | None = Field(default=None, description="mapping file")
    load: Annotated[float, Field(ge=0, le=1e6)] | None = Field(
        default=None, description="mass that was held all the time, kg; 0 for none"
    )
    temperature: Annotated[float, Field(ge=-273.15, le=1e4)] | None = Field(
        default=None, description="of gears or oil, °C"
    )

    @field_validator("time", mode="before")
    @classmethod
    def _is_written_out(cls, time: object) -> object:
        # 01/02/2026 is ambiguous, and 20260131 would be seconds.
        if isinstance(time, str | int | float) and not _ISO.match(str(time)):
            raise ValueError(_TIMES)
        try:  # strict validation accepts no text after a validator
            if isinstance(time, str):
                time = datetime.fromisoformat(time)
                if time.tzinfo is not None:
                    time.astimezone(UTC)  # which the first and last days may not have
            return time
        except (ValueError, OverflowError):
            raise ValueError(_TIMES) from None


class FleetRobot(Part):
    """One robot of a fleet."""

    robot: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[\w][\w.+ -]*$")]
    type: str | None = Field(
        default=None, min_length=1, description="catalogue name, or file of a robot or a model"
    )
    columns: str | None = Field(default=None, description="mapping file of its recordings")
    recordings: _Path | tuple[_Path | RecordedFile, ...]


class Manifest(Part):
    """A fleet as a user writes it."""

    type: str | None = Field(
        default=None, min_length=1, description="of robots that do not say their own"
    )
    columns: str | None = Field(default=None, description="mapping file of all recordings")
    period: Period = Field(default="week", description="recordings of one are fitted together")
    robots: Annotated[tuple[FleetRobot, ...], Field(min_length=1)]

    def entries(self, where: str) -> Iterator[tuple[str, str, RecordedFile, str | None]]:
        """Entries of all robots with defaults filled in: robot, type, recordings, mapping file.

        Raises:
            DescriptionError: a robot has no type, or two.
        """
        types = dict[str, str]()
        for robot in self.robots:
            kind = robot.type or self.type
            if kind is None:
                raise DescriptionError(
                    f"robot {robot.robot} has no type",
                    where=where,
                    cure="give type, a catalogue name or a description file, of the robot or all",
                )
            if types.setdefault(robot.robot, kind) != kind:
                both = f"{quoted(types[robot.robot])} and {quoted(kind)}"
                raise DescriptionError(
                    f"robot {robot.robot} has two types, {both}",
                    where=where,
                    cure="give each robot one type, or the two robots names of their own",
                )
            given = robot.recordings
            for entry in (given,) if isinstance(given, str) else given:
                file = RecordedFile(path=entry) if isinstance(entry, str) else entry
                yield robot.robot, kind, file, file.columns or robot.columns or self.columns


def read_manifest(name: str) -> Manifest:
    """The manifest of a path or address.

    Raises:
        DescriptionError: it cannot be read, or is wrong, with line or row, and key.
    """
    cure = "give the YAML, CSV or Parquet file of a fleet"
    if not is_address(name) and os.path.isdir(name):
        raise DescriptionError("is a folder, not a file", where=name, cure=cure)
    data = read(name)
    if data is None:
        raise DescriptionError("no such file", where=name, cure=cure)
    ending = f".{name.rpartition('.')[2].lower()}"
    if ending in _TABLES:
        return _of_table(data, ending, name)
    try:
        return parse(data.decode("utf-8-sig"), Manifest, where=name)
    except UnicodeDecodeError:
        raise DescriptionError(
            "is not text in UTF-8", where=name, cure="a fleet is a YAML, CSV or Parquet file"
        ) from None


def beside(name: str, manifest: str) -> str:
    """Address, or path relative to a manifest's folder, of a name in it."""
    if is_address(name):
        return name
    if is_address(manifest):
        return f"{manifest.rpartition('/')[0]}/{name}"
    path = Path(os.path.expanduser(name))  # that of pathlib fails where there is no such user
    return str(path if path.is_absolute() else Path(manifest).parent.resolve() / path)


def _of_table(data: bytes, ending: str, where: str) -> Manifest:
    try:
        table = (
            pl.read_csv(data, infer_schema_length=None)
            if ending == ".csv"
            else pl.read_parquet(BytesIO(data))
        )
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise DescriptionError(
            f"cannot be read: {quoted(str(error).splitlines()[0])}",
            where=where,
            cure="check the file",
        ) from None
    _require_columns(table, where)
    robots = list[FleetRobot]()
    for k, row in enumerate(table.iter_rows(named=True), start=2 if ending == ".csv" else 1):
        place = f"{where}, row {k}"
        given = {
            key: x.isoformat() if isinstance(x, datetime | date) else x
            for key, x in row.items()
            if x is not None
        }
        for key in ("robot", "recording"):
            if given.get(key) in (None, ""):
                raise DescriptionError(f"{key} is missing", where=place, cure="fill it in")
        given |= {key: str(given[key]) for key in _COLUMNS[:4] if key in given}
        name, kind, path = given.pop("robot"), given.pop("type", None), given.pop("recording")
        file = RecordedFile.from_dict(given | {"path": path}, place)
        named = {"robot": name, "recordings": ()} | ({"type": kind} if kind else {})
        robots.append(FleetRobot.from_dict(named, place).changed(recordings=(file,)))
    if not robots:
        raise DescriptionError("has no rows", where=where, cure="give a row a recording")
    return Manifest(robots=tuple(robots))


def _require_columns(table: pl.DataFrame, where: str) -> None:
    for name in table.columns:
        if name not in _COLUMNS:
            raise DescriptionError(
                f"has the unknown column {quoted(name)}",
                where=where,
                cure=f"{nearest(name, _COLUMNS)}its columns may be {', '.join(_COLUMNS)}",
            )
    for name in _COLUMNS[:2]:
        if name not in table.columns:
            raise DescriptionError(
                f"has no column {name}",
                where=where,
                cure=f"its columns may be {', '.join(_COLUMNS)}; robot and recording must be",
            )


# A date within a name: 2026-01-31, 20260131, optionally with a time.
DATE = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[:h-]?([0-5]\d)(?:[:m-]?([0-5]\d))?)?(?!\d)"
)
_UNDATED = (
    "nothing says when it was made\n"
    "  → give its time, or put a date such as 2026-01-31 into its name or folder"
)
# Folders such as year=2026/month=01/day=31.
_KEYS = re.compile(r"\b(?:year|month|day|date|hour)=", re.IGNORECASE)


@dataclass(frozen=True, order=True)
class Recorded:
    """One recording of a fleet.

    Attributes:
        robot: its name.
        time: of the recording.
        path: local path or address.
        type: of the robot, as in the manifest.
        columns: mapping file; empty for default names.
        load: mass held throughout [kg]; None if not declared.
        temperature: [°C]; None if unknown.
        stamp: changes when the file does; empty if it is missing.
    """

    robot: str
    time: datetime
    path: str
    type: str
    columns: str = ""
    load: float | None = None
    temperature: float | None = None
    stamp: str = ""


@dataclass(frozen=True)
class Quarantined:
    """A line of the quarantine.

    Attributes:
        what: 'recording', 'fit', 'drift', 'type'.
        robot: its name.
        which: path, pattern, period or type.
        reason: in words.
        key: checksum of the inputs; empty if the next call tries again.
    """

    what: str
    robot: str
    which: str
    reason: str
    key: str = ""


@dataclass(frozen=True)
class Fleet:
    """All recordings of a fleet, sorted by robot and time.

    Attributes:
        recordings: each once.
        types: file of each type's description.
        period: of recordings that are fitted together.
        absent: named recordings that are missing, or have no date.
        entries: robot, and path or pattern, of all entries of the manifest.
        mappings: all files of columns in the manifest.
    """

    recordings: tuple[Recorded, ...]
    types: dict[str, str]
    period: Period = "week"
    absent: tuple[Quarantined, ...] = ()
    entries: tuple[tuple[str, str], ...] = ()
    mappings: tuple[str, ...] = ()


def find_fleet(manifest: str, period: Period | None = None) -> Fleet:
    """The fleet of a manifest; paths are relative to its folder.

    Args:
        period: in place of the manifest's.

    Raises:
        DescriptionError: the manifest is wrong, or gives a recording to two robots.
        StoreError: a store cannot be reached.
    """
    read, absent, types = read_manifest(manifest), list[Quarantined](), dict[str, str]()
    recordings, mappings = dict[str, Recorded](), set[str]()
    named = [(beside(entry[2].path, manifest), entry) for entry in read.entries(manifest)]
    single = stamps_of(pattern for pattern, _ in named if not has_pattern(pattern))
    for pattern, (robot, kind, file, columns) in named:
        types[kind] = kind if kind in catalogue() else beside(kind, manifest)
        if has_pattern(pattern):
            matches, why = matching(pattern), "no file answers to it"
        else:
            matches = {pattern: single[pattern]} if pattern in single else {}
            why = "no such file"
        if not matches:
            reason = f"{why}\n  → check the manifest"
            absent.append(Quarantined("recording", robot, pattern, reason))
        mapping = beside(columns, manifest) if columns else ""
        mappings.add(mapping)
        for path, stamp in matches.items():
            time = _time(file, path)
            if time is None:
                absent.append(Quarantined("recording", robot, path, _UNDATED))
                continue
            recording = Recorded(
                robot, time, path, kind, mapping, file.load, file.temperature, stamp
            )
            if (first := recordings.setdefault(path, recording)) != recording:
                raise DescriptionError(
                    f"{path} is given twice, for {first.robot} and for {robot}"
                    if first.robot != robot
                    else f"{path} is given twice, with different words about it",
                    where=manifest,
                    cure="give each recording once; patterns may overlap",
                )
    return Fleet(
        tuple(sorted(recordings.values())),
        types,
        period or read.period,
        tuple(dict.fromkeys(absent)),
        tuple((robot, pattern) for pattern, (robot, *_) in named),
        tuple(sorted(mappings - {""})),
    )


def period_of(time: datetime, period: Period) -> str:
    """Name of the period of a time: 2026-W05, 2026-01, 2026-01-31, all."""
    if period == "week":
        year, week, _ = time.isocalendar()
        return f"{year}-W{week:02d}"
    return {"day": f"{time:%Y-%m-%d}", "month": f"{time:%Y-%m}", "all": "all"}[period]


def datetime_of(match: re.Match[str]) -> datetime:
    """The date, and perhaps time, that `DATE` matches.

    Raises:
        ValueError: there is no such day, such as the 31st of February.
    """
    year, month, day, hour, minute, second = (int(part or 0) for part in match.groups())
    return datetime(year, month, day, hour, minute, second)


def _time(file: RecordedFile, path: str) -> datetime | None:
    """Time of a recording as given, or from its name or folders."""
    if (given := file.time) is not None:
        is_time = isinstance(given, datetime)
        time = given if is_time else datetime(given.year, given.month, given.day)
        return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time
    folders = _KEYS.sub("", path.replace("\\", "/")).replace("/", "-")
    for text in (Path(path).name, folders):
        for match in reversed(list(DATE.finditer(text))):
            with suppress(ValueError):
                return datetime_of(match)
    return None
