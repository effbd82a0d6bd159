"""A fleet from its manifest: robots, their types, and all of their recordings with their times."""

import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from deltaid.errors import DescriptionError
from deltaid.fleets.manifest import RecordedFile, address_of, read_manifest
from deltaid.fleets.store import has_pattern, is_folder, matching, stamps_of
from deltaid.model.options import Period
from deltaid.robot.load import catalogue

# A date within a name: 2026-01-31, 20260131, optionally with a time.
DATE = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[T_ -]?([01]\d|2[0-3])[:h-]?([0-5]\d)(?:[:m-]?([0-5]\d))?)?(?!\d)"
)
_UNDATED = (
    "nothing says when it was made\n"
    "  → give its time, or put a date such as 2026-01-31 into its name or folder"
)
# The period of all recordings of a robot together, and the form of each period's name: 2026-01-31,
# 2026-W05, 2026-01.
ALL = "all"
PERIODS = {"day": "%Y-%m-%d", "week": "%G-W%V", "month": "%Y-%m", ALL: ALL}
_CHECK = "\n  → check the manifest"
# Names of folders such as year=2026/month=01/day=31.
_KEYS = re.compile(r"\b(?:year|month|day|date|hour)=", re.IGNORECASE)


@dataclass(frozen=True, order=True)
class Recorded:
    """One recording of a fleet.

    Attributes:
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
    named = [(address_of(entry[2].path, manifest), entry) for entry in read.entries(manifest)]
    single = stamps_of(pattern for pattern, _ in named if not has_pattern(pattern))
    for pattern, (robot, kind, file, columns) in named:
        types[kind] = kind if kind in catalogue() else address_of(kind, manifest)
        if has_pattern(pattern):
            matches, why = matching(pattern), f"no file answers to it{_CHECK}"
        else:
            matches = {pattern: single[pattern]} if pattern in single else {}
            files = f"\n  → name the files in it by a pattern, such as {pattern}/*.csv"
            why = f"is a folder{files}" if is_folder(pattern) else f"no such file{_CHECK}"
        if not matches:
            absent.append(Quarantined("recording", robot, pattern, why))
        mapping = address_of(columns, manifest) if columns else ""
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


def date_within(name: str) -> datetime | None:
    """Last valid date in a name, with its time if it has one; None without a date."""
    for match in reversed(list(DATE.finditer(name))):
        with suppress(ValueError):  # such as the 31st of February
            year, month, day, hour, minute, second = (int(part or 0) for part in match.groups())
            return datetime(year, month, day, hour, minute, second)
    return None


def _time(file: RecordedFile, path: str) -> datetime | None:
    """Time of a recording as given, or from its name or folders."""
    if (given := file.time) is not None:
        is_time = isinstance(given, datetime)
        time = given if is_time else datetime(given.year, given.month, given.day)
        return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time
    folders = _KEYS.sub("", path.replace("\\", "/")).replace("/", "-")
    return date_within(Path(path).name) or date_within(folders)
