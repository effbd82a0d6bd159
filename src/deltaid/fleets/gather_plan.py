"""How recordings of a fleet are gathered: descriptions, mappings, and one filter for each type."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.fleet import Fleet, Recorded
from deltaid.fleets.gather_one import GatherJob, How, suggested_cutoff
from deltaid.fleets.place import Place
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
class GatherPlan:
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
    def from_manifest(
        cls, fleet: Fleet, place: Place, settings: Settings, *, force: bool
    ) -> "GatherPlan":
        """What a fleet's manifest says; what cannot be read does not stop the rest."""
        wrong = dict[str, DeltaidError]()

        def read(names: Mapping[str, str], load: Callable[[Path], _Read]) -> dict[str, _Read]:
            values = dict[str, _Read]()
            for name, file in names.items():
                try:
                    with place.store.local(file) as path:
                        values[name] = load(path)
                except FileNotFoundError:
                    wrong[name] = RecordingError(
                        "no such file", where=file, cure="check the manifest"
                    )
                except DeltaidError as error:
                    wrong[name] = error
            return values

        robots = read(fleet.types, _robot)
        columns = {recorded.columns for recorded in fleet.recordings} - {""}
        mappings = read({name: name for name in sorted(columns)}, load_mapping)
        return cls(settings, force, robots, mappings, {}, wrong)

    def how(self, recorded: Recorded) -> How:
        """How a recording is gathered.

        Raises:
            DeltaidError: its description or mapping is wrong.
        """
        for name in (recorded.type, recorded.columns):
            if name in self.wrong:
                raise self.wrong[name]
        kind = (recorded.type, recorded.columns, recorded.load)
        if kind not in self.hows:
            self.hows[kind] = self._how(recorded)
        return self.hows[kind]

    def _how(self, recorded: Recorded) -> How:
        settings, kind = self.settings, recorded.type
        if settings.cutoff is None and kind in self.cutoffs:
            settings = settings.changed(cutoff=self.cutoffs[kind])
        how = How(self.robots[kind], self.mappings.get(recorded.columns), settings, self.force)
        return how.holding(recorded.load, recorded.path)


def with_cutoffs(
    plan: GatherPlan, fleet: Fleet, place: Place, client: "Callable[[], Client]"
) -> GatherPlan:
    """The same with a cut-off for each type.

    Recordings go together only with one filter. Where none is given, the first usable recording
    decides for its type, once: the file `decided.json` keeps it.
    """
    if plan.settings.cutoff is not None:
        return plan
    known = _decided(place)
    wrong, cutoffs = dict(plan.wrong), dict(known)
    for kind in plan.robots:
        if kind in cutoffs:
            continue
        jobs = [*islice(_jobs(plan, fleet, kind), _ASKED)]
        asked = (client().submit(suggested_cutoff, job, place, pure=False) for job in jobs)
        cutoff = next((x for future in asked if (x := future.result()) is not None), None)
        if cutoff is not None:
            cutoffs[kind] = cutoff
        elif jobs:
            wrong[kind] = RecordingError(
                f"none of its first {len(jobs)} recordings tells a cut-off",
                where=kind,
                cure="check these with `deltaid check`, or give --cutoff",
            )
    if cutoffs != known:
        place.store.write(
            place.path_to(DECIDED), json.dumps({"cutoff_hz": cutoffs}, indent=2).encode()
        )
    return replace(plan, cutoffs=cutoffs, wrong=wrong, hows={})


def _jobs(plan: GatherPlan, fleet: Fleet, kind: str) -> Iterator[GatherJob]:
    """Recordings of a type that can be gathered, in the order of time."""
    recordings = [recorded for recorded in fleet.recordings if recorded.type == kind]
    for recorded in sorted(recordings, key=lambda recorded: (recorded.time, recorded.path)):
        try:
            yield GatherJob.for_recording(recorded, plan.how(recorded))
        except DeltaidError:
            continue


def _decided(place: Place) -> dict[str, float]:
    data = place.store.read(place.path_to(DECIDED))
    if data is None:
        return {}
    try:
        return {str(kind): float(x) for kind, x in json.loads(data)["cutoff_hz"].items()}
    except (ValueError, KeyError, AttributeError, TypeError):
        raise DeltaidError(
            "does not hold a cut-off for each type",
            where=place.path_to(DECIDED),
            cure="remove it, and all is gathered again, or give --cutoff",
        ) from None


def _robot(path: Path) -> RobotDescription:
    return described(str(path) if str(path) in catalogue() else path)
