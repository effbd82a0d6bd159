"""How recordings of a fleet are gathered: descriptions, mappings, and one filter for each type."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.fleet import Fleet, Recorded
from deltaid.fleets.gather_one import How, Job, told_cutoff
from deltaid.fleets.place import Place
from deltaid.fleets.store import is_address
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, described

if TYPE_CHECKING:
    from distributed import Client

DECIDED = "decided.json"
# Recordings of a type that are asked for a cut-off, one after the other, until one can be used.
_ASKED = 20

_Read = TypeVar("_Read")


@dataclass(frozen=True)
class Ways:
    """What recordings are gathered with, or why they cannot be.

    Attributes:
        settings: of all.
        force: go on with what the checks call wrong.
        robots: descriptions, by type.
        mappings: by the manifest's name.
        cutoffs: of each type [Hz].
        wrong: what is wrong, by type or mapping.
        hows: what has been asked for, by type, mapping and load: a fleet has few.
    """

    settings: Settings
    force: bool
    robots: Mapping[str, RobotDescription]
    mappings: Mapping[str, ColumnMapping]
    cutoffs: Mapping[str, float] = field(default_factory=dict)
    wrong: Mapping[str, DeltaidError] = field(default_factory=dict)
    hows: dict[tuple[str, str, float | None], How] = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, fleet: Fleet, place: Place, settings: Settings, *, force: bool) -> "Ways":
        """What a fleet's manifest says; what cannot be read does not stop the rest."""
        wrong = dict[str, DeltaidError]()

        def read(name: str, at: str, how: Callable[[str], _Read]) -> Iterable[tuple[str, _Read]]:
            try:
                if is_address(at):
                    with place.store.local(at) as path:
                        yield name, how(str(path))
                else:
                    yield name, how(at)
            except FileNotFoundError:
                wrong[name] = RecordingError("no such file", where=at, cure="check the manifest")
            except DeltaidError as error:
                wrong[name] = error

        def each(names: Mapping[str, str], how: Callable[[str], _Read]) -> dict[str, _Read]:
            return dict(pair for name, at in names.items() for pair in read(name, at, how))

        columns = {one.columns: one.columns for one in fleet.recordings if one.columns}
        robots = each(fleet.types, _robot)
        mappings = each(columns, lambda path: load_mapping(Path(path)))
        return cls(settings, force, robots, mappings, {}, wrong)

    def how(self, one: Recorded) -> How:
        """How a recording is gathered.

        Raises:
            DeltaidError: its description or mapping is wrong.
        """
        kind = (one.type, one.columns, one.load)
        if kind not in self.hows:
            self.hows[kind] = self._how(one)
        return self.hows[kind]

    def _how(self, one: Recorded) -> How:
        settings = self.settings
        if settings.cutoff is None and one.type in self.cutoffs:
            settings = settings.changed(cutoff=self.cutoffs[one.type])
        how = How(self.robots[one.type], self.mappings.get(one.columns), settings, self.force)
        return how.holding(one.load, one.path)

    def require(self, one: Recorded) -> None:
        """Refuse a recording that cannot be gathered.

        Raises:
            RecordingError: its description or its mapping is wrong.
        """
        for name in (one.type, one.columns):
            if name in self.wrong:
                raise self.wrong[name]


def with_cutoffs(ways: Ways, fleet: Fleet, place: Place, client: "Callable[[], Client]") -> Ways:
    """The same with a cut-off for each type.

    Recordings go together only with one filter. Where none is given, the first usable recording
    decides for its type, once: the file `decided.json` keeps it.
    """
    if ways.settings.cutoff is not None:
        return ways
    known = _decided(place)
    wrong, found = dict(ways.wrong), dict(known)
    for kind in ways.robots:
        if kind in found:
            continue
        own = [one for one in fleet.recordings if one.type == kind and one.columns not in wrong]
        own.sort(key=lambda one: (one.time, one.path))
        for one in own[:_ASKED]:
            try:
                job = Job.of(one, ways.how(one))
            except DeltaidError:
                continue
            told = client().submit(told_cutoff, job, place, pure=False).result()
            if told is not None:
                found[kind] = told
                break
        else:
            if own:
                wrong[kind] = RecordingError(
                    f"none of its first {len(own[:_ASKED])} recordings tells a cut-off",
                    where=kind,
                    cure="check these with `deltaid check`, or give --cutoff",
                )
    if found != known:
        place.store.write(place.at(DECIDED), json.dumps({"cutoff_hz": found}, indent=2).encode())
    return Ways(ways.settings, ways.force, ways.robots, ways.mappings, found, wrong)


def _decided(place: Place) -> dict[str, float]:
    data = place.store.read(place.at(DECIDED))
    if data is None:
        return {}
    try:
        return {str(kind): float(x) for kind, x in json.loads(data)["cutoff_hz"].items()}
    except (ValueError, KeyError, AttributeError, TypeError):
        raise DeltaidError(
            "does not hold a cut-off for each type",
            where=place.at(DECIDED),
            cure="remove it, and all is gathered again, or give --cutoff",
        ) from None


def _robot(at: str) -> RobotDescription:
    return described(at if at in catalogue() else Path(at))
