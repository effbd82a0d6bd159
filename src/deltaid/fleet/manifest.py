"""What a fleet is made of: which robots there are, of which type, and where their recordings lie.

YAML with a list of robots, or a table (CSV, Parquet) with one row a recording. Recordings are local
paths or addresses of any store that fsspec knows, such as s3://plant/line1/*.parquet.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
from pydantic import Field

from deltaid.errors import DescriptionError
from deltaid.fleet.store import Store
from deltaid.robot.load import parse, read_text
from deltaid.robot.part import Part

Period = Literal["day", "week", "month", "all"]
# A date within a name: 2026-01-31, 20260131, perhaps with a time behind it.
_DATE = re.compile(
    r"(?<!\d)(20\d\d)-?(0[1-9]|1[0-2])-?(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[:h-]?([0-5]\d)(?:[:m-]?([0-5]\d))?)?(?!\d)"
)
_TABLES = (".csv", ".parquet")
_COLUMNS = ("robot", "type", "recording", "time", "columns", "load", "temperature")


class RecordedFile(Part):
    """One recording, or several by a pattern."""

    path: Annotated[str, Field(min_length=1)]
    time: datetime | date | None = Field(
        default=None, description="when it was made; by a date in its name if left out"
    )
    columns: str | None = Field(default=None, description="mapping file")
    load: Annotated[float, Field(ge=0)] | None = Field(
        default=None, description="mass that was held all the time, kg; 0 for none"
    )
    temperature: float | None = Field(default=None, description="of gears or oil, °C")


class FleetRobot(Part):
    """One robot of a fleet."""

    robot: Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[\w][\w.+ -]*$")]
    type: str | None = Field(default=None, description="catalogue name or description file")
    columns: str | None = None
    recordings: str | tuple[str | RecordedFile, ...]


class Manifest(Part):
    """A fleet as a user writes it."""

    type: str | None = Field(default=None, description="of robots that do not say their own")
    columns: str | None = Field(default=None, description="mapping file of all recordings")
    period: Period = Field(default="week", description="recordings of one are fitted together")
    robots: Annotated[tuple[FleetRobot, ...], Field(min_length=1)]


@dataclass(frozen=True, order=True)
class Recorded:
    """One recording of a fleet.

    Attributes:
        robot: whose.
        time: when it was made.
        path: where it lies, a path or an address.
        type: the robot's description.
        columns: mapping file; None for default names.
        load: mass that was held all the time [kg]; None if nothing is said.
        temperature: [°C]; None if not known.
    """

    robot: str
    time: datetime
    path: str
    type: str
    columns: str | None = None
    load: float | None = None
    temperature: float | None = None


@dataclass(frozen=True)
class Fleet:
    """All recordings of a fleet, in the order of robots and time.

    Attributes:
        recordings: each once.
        period: of which recordings are fitted together.
        unmatched: patterns that no file answers to.
    """

    recordings: tuple[Recorded, ...]
    period: Period = "week"
    unmatched: tuple[str, ...] = ()

    @property
    def robots(self) -> tuple[str, ...]:
        """Names, in order."""
        return tuple(dict.fromkeys(one.robot for one in self.recordings))


def read_fleet(path: Path, store: Store) -> Fleet:
    """The fleet of a manifest; paths are seen from its folder.

    Raises:
        DescriptionError: it cannot be read, says something twice, or a recording has no date.
    """
    manifest = _of_table(path) if path.suffix.lower() in _TABLES else _of_yaml(path)
    found, unmatched = list[Recorded](), list[str]()
    for k, robot in enumerate(manifest.robots):
        kind = robot.type or manifest.type
        if kind is None:
            raise DescriptionError(
                f"{robot.robot} has no type",
                where=f"{path}, robots[{k}].type",
                cure="give type: a catalogue name or a description file, here or for all robots",
            )
        for one in _files(robot):
            matches = store.matching(one.path, path.parent)
            if not matches:
                unmatched.append(f"{robot.robot}: {one.path}")
            for address in matches:
                columns = one.columns or robot.columns or manifest.columns
                found.append(
                    Recorded(
                        robot.robot,
                        _time(one, address, path),
                        address,
                        store.beside(kind, path.parent),
                        columns and store.beside(columns, path.parent),
                        one.load,
                        one.temperature,
                    )
                )
    _require_once(found, path)
    return Fleet(tuple(sorted(found)), manifest.period, tuple(unmatched))


def period_of(time: datetime, period: Period) -> str:
    """The name of the period that a time falls into: 2026-W05, 2026-01, 2026-01-31, all."""
    if period == "week":
        year, week, _ = time.isocalendar()
        return f"{year}-W{week:02d}"
    return {"day": f"{time:%Y-%m-%d}", "month": f"{time:%Y-%m}", "all": "all"}[period]


def _of_yaml(path: Path) -> Manifest:
    return parse(read_text(path), Manifest, where=str(path))


def _of_table(path: Path) -> Manifest:
    """A manifest from a table with one row a recording."""
    try:
        table = (
            pl.read_csv(path, try_parse_dates=True)
            if path.suffix.lower() == ".csv"
            else pl.read_parquet(path)
        )
    except (OSError, pl.exceptions.PolarsError) as error:
        raise DescriptionError(
            f"cannot be read: {str(error).splitlines()[0]}", where=str(path), cure="check the file"
        ) from None
    missing = [name for name in ("robot", "recording") if name not in table.columns]
    unknown = [name for name in table.columns if name not in _COLUMNS]
    if missing or unknown:
        which = missing or unknown
        raise DescriptionError(
            f"has {'no column' if missing else 'the unknown column'} {which[0]}",
            where=str(path),
            cure=f"its columns may be {', '.join(_COLUMNS)}, of which robot and recording must be",
        )
    robots: dict[tuple[str, str | None], list[RecordedFile]] = {}
    for k, row in enumerate(table.iter_rows(named=True), start=2):
        where = f"{path}, row {k}"
        if row["robot"] is None or row["recording"] is None:
            raise DescriptionError("names no robot or no recording", where=where, cure="fill it in")
        keys = ("time", "columns", "load", "temperature")
        given: dict[str, Any] = {key: row.get(key) for key in keys}
        one = _checked(given | {"path": str(row["recording"])}, where)
        robots.setdefault((str(row["robot"]), row.get("type")), []).append(one)
    return Manifest(
        robots=tuple(
            FleetRobot(robot=name, type=kind, recordings=tuple(files))
            for (name, kind), files in robots.items()
        )
    )


def _checked(values: dict[str, Any], where: str) -> RecordedFile:
    from pydantic import ValidationError

    try:
        return RecordedFile(**{key: x for key, x in values.items() if x is not None})
    except ValidationError as error:
        first = error.errors()[0]
        raise DescriptionError(
            f"{first['loc'][0]}: {first['msg']}", where=where, cure="mend this cell"
        ) from None


def _files(robot: FleetRobot) -> Iterable[RecordedFile]:
    given = robot.recordings
    for one in (given,) if isinstance(given, str) else given:
        yield RecordedFile(path=one) if isinstance(one, str) else one


def _time(one: RecordedFile, address: str, manifest: Path) -> datetime:
    """When a recording was made, by what is said or by its name."""
    if one.time is not None:
        time = one.time if isinstance(one.time, datetime) else datetime(*one.time.timetuple()[:3])
        return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time
    name = address.replace("\\", "/").rpartition("/")[2]
    if (match := _DATE.search(name)) is None:
        raise DescriptionError(
            f"nothing says when {address} was made",
            where=str(manifest),
            cure="give its time, or put a date such as 2026-01-31 into its name",
        )
    parts = [int(part) for part in match.groups() if part is not None]
    try:
        return datetime(*parts)  # type: ignore[arg-type]
    except ValueError:
        raise DescriptionError(
            f"the date in the name of {address} does not exist",
            where=str(manifest),
            cure="give its time",
        ) from None


def _require_once(found: Sequence[Recorded], path: Path) -> None:
    seen: dict[str, str] = {}
    for one in found:
        if one.path in seen:
            raise DescriptionError(
                f"{one.path} is given twice, for {seen[one.path]} and for {one.robot}",
                where=str(path),
                cure="give each recording once; patterns may overlap",
            )
        seen[one.path] = one.robot
