"""The manifest of a fleet: YAML with a list of robots, or a table (CSV, Parquet) with one row per
recording or pattern.

Recordings are local paths or addresses of any store that fsspec supports, such as
s3://plant/line1/*.parquet.
"""

import os
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, date, datetime
from io import BytesIO
from pathlib import Path
from typing import Annotated

import polars as pl
from pydantic import Field, field_validator

from deltaid.errors import DescriptionError, nearest, quoted
from deltaid.fleets.store import is_address, is_folder, read
from deltaid.model.options import Period
from deltaid.recording.source import POLARS_ERRORS, first_line
from deltaid.robot.load import parse
from deltaid.robot.part import Part

_ISO = re.compile(r"\d{4}-\d{2}-\d{2}")
_TIMES = "must be a day as 2026-01-31, or a time as 2026-01-31T08:30, not {:.40}"
_TABLES = (".csv", ".parquet")
# Columns of a table: the first two are required, the first four are text.
_COLUMNS = ("robot", "recording", "type", "columns", "time", "load", "temperature")
# Longest path: the limit of Linux, the largest of any system.
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
            raise ValueError(_TIMES.format(str(time)))
        try:  # strict validation accepts no text after a validator
            if isinstance(time, str):
                time = datetime.fromisoformat(time)
                if time.tzinfo is not None:
                    time.astimezone(UTC)  # fails near the first and last possible dates
            return time
        except (ValueError, OverflowError):
            raise ValueError(_TIMES.format(str(time))) from None


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
    if is_folder(name):
        raise DescriptionError("is a folder, not a file", where=name, cure=cure)
    data = read(name)
    if data is None:
        raise DescriptionError("no such file", where=name, cure=cure)
    ending = f".{name.rpartition('.')[2].lower()}"
    if ending in _TABLES:
        return _of_table(data, ending, name)
    try:
        manifest = parse(data.decode("utf-8-sig"), Manifest, where=name)
    except UnicodeDecodeError:
        raise DescriptionError(
            "is not text in UTF-8", where=name, cure="a fleet is a YAML, CSV or Parquet file"
        ) from None
    _require_apart([robot.robot for robot in manifest.robots], name)
    return manifest


def _require_apart(robots: Iterable[str], where: str) -> None:
    """Refuse robots of one name, which would be fitted as one, and names that differ in capital
    letters only, which many disks take for one file."""
    names = dict[str, str]()
    for robot in robots:
        if same := names.get(robot.casefold()):
            raise DescriptionError(
                f"robot {same} is there twice"
                if same == robot
                else f"robots {same} and {robot} differ in capital letters only",
                where=where,
                cure="list all recordings of a robot at one place, under one spelling, or give "
                "two robots names of their own",
            )
        names[robot.casefold()] = robot


def address_of(name: str, manifest: str) -> str:
    """Address, or path relative to a manifest's folder, of a name in it."""
    if is_address(name):
        return name
    if is_address(manifest):
        return f"{manifest.rpartition('/')[0]}/{name}"
    path = Path(os.path.expanduser(name))  # Path.expanduser raises for an unknown user
    return str(path if path.is_absolute() else Path(manifest).parent.resolve() / path)


def _of_table(data: bytes, ending: str, where: str) -> Manifest:
    header = data.partition(b"\n")[0].decode("utf-8", "replace")
    try:
        table = (
            pl.read_csv(data, separator=max(",;\t", key=header.count), infer_schema_length=None)
            if ending == ".csv"
            else pl.read_parquet(BytesIO(data))
        )
    except (OSError, *POLARS_ERRORS) as error:
        raise DescriptionError(
            f"cannot be read: {first_line(error)}",
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
    _require_apart(dict.fromkeys(robot.robot for robot in robots), where)
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
