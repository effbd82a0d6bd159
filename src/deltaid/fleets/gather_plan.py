"""How recordings of a fleet are gathered: descriptions, mappings, and one filter for each type."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TypeVar

from deltaid.errors import DeltaidError, RecordingError
from deltaid.fleets.factor_file import ENDING, digest, safe, ways
from deltaid.fleets.fleet import Fleet, Recorded
from deltaid.fleets.place import Place
from deltaid.fleets.store import local_file
from deltaid.fleets.workers import ALONE, Workers
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.opening import open_log
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, described

FACTORS = "factors"
DECIDED = "decided.json"
# Recordings of a type that are asked for a cut-off, one after the other, until one can be used.
_ASKED = 20

_Read = TypeVar("_Read")


@dataclass(frozen=True)
class How:
    """What a recording is gathered with.

    Attributes:
        robot: whose it is.
        mapping: of its columns.
        settings: of filter, masks and corrections.
        force: go on with what the checks call wrong.
    """

    robot: RobotDescription
    mapping: ColumnMapping | None
    settings: Settings
    force: bool = False

    @cached_property
    def digest(self) -> str:
        """A checksum of all this, and of the version that gathers."""
        own = ways(self.robot, self.mapping, self.settings)
        return digest([own, self.force, version("deltaid")])


@dataclass(frozen=True)
class GatherJob:
    """A recording that is to be gathered, and how."""

    recorded: Recorded
    how: How

    @cached_property
    def key(self) -> str:
        """Checksum of all that follows from, by the recording's stamp: nothing is read for it."""
        return digest([self.recorded.path, self.recorded.stamp, self.how.digest])

    @property
    def file(self) -> str:
        """Name of the factor file, seen from the fleet's folder."""
        robot, log = safe(self.recorded.robot), safe(Path(self.recorded.path).stem)
        return f"{FACTORS}/{robot}/{log}-{self.key[:12]}{ENDING}"


@dataclass(frozen=True)
class GatherResult:
    """What became of one recording.

    Attributes:
        recorded: which.
        key: checksum of what its factors follow from; empty where another call may end otherwise.
        file: its factor file, seen from the fleet's folder; empty if it was refused.
        reason: why it is in quarantine; empty if it is not.
        is_new: whether it was looked at now.
        bytes: size of the factor file.
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
    bytes: int = 0
    sha256: str = ""
    samples: int = 0
    verdicts: str = ""
    how: str = ""


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
    def from_manifest(cls, fleet: Fleet, settings: Settings, *, force: bool) -> "GatherPlan":
        """What a fleet's manifest says; what cannot be read does not stop the rest."""
        wrong = dict[str, DeltaidError]()

        def read(names: Mapping[str, str], load: Callable[[Path], _Read]) -> dict[str, _Read]:
            values = dict[str, _Read]()
            for name, file in names.items():
                try:
                    with local_file(file) as path:
                        values[name] = load(path)
                except FileNotFoundError:
                    wrong[name] = RecordingError(
                        "no such file", where=file, cure="check the manifest"
                    )
                except DeltaidError as error:
                    wrong[name] = error
            return values

        robots = read(
            fleet.types, lambda path: described(str(path) if str(path) in catalogue() else path)
        )
        mappings = read({name: name for name in fleet.mappings}, load_mapping)
        return cls(settings, force, robots, mappings, {}, wrong)

    def how(self, recorded: Recorded) -> How:
        """How a recording is gathered.

        Raises:
            DeltaidError: its description or mapping is wrong, or both its mapping and the manifest
                say what it holds.
        """
        for name in (recorded.type, recorded.columns):
            if name in self.wrong:
                raise self.wrong[name]
        kind, mass = (recorded.type, recorded.columns, recorded.load), recorded.load
        if kind not in self.hows:
            settings, mapping = self.settings, self.mappings.get(recorded.columns)
            if settings.cutoff is None and recorded.type in self.cutoffs:
                settings = settings.changed(cutoff=self.cutoffs[recorded.type])
            if mass is not None and mapping is not None and mapping.load is not None:
                raise RecordingError(
                    "its mapping and the manifest both say what it holds",
                    where=recorded.path,
                    cure="say it in one of them",
                )
            if mass:
                # Loads of one name are the same thing, so those of another mass have another name.
                load = Load(always=True, mass=mass, name=f"load-{round(1e6 * mass)}mg")
                mapping = (mapping or ColumnMapping()).changed(load=load)
            self.hows[kind] = How(self.robots[recorded.type], mapping, settings, self.force)
        return self.hows[kind]


def with_cutoffs(
    plan: GatherPlan, fleet: Fleet, place: Place, workers: Callable[[], Workers]
) -> GatherPlan:
    """The same with a cut-off for each type.

    Recordings go together only with one filter. Where none is given, the first usable recording
    decides for its type, once: the file `decided.json` keeps it.
    """
    if plan.settings.cutoff is not None:
        return plan
    known = _decided(place)
    wrong, cutoffs = dict(plan.wrong), dict(known)
    for kind in (kind for kind in plan.robots if kind not in known):
        jobs = [*islice(_jobs(plan, fleet, kind), _ASKED)]
        asked = (
            next(iter(workers().done(suggested_cutoff, [job], lambda *_: None))) for job in jobs
        )
        cutoff = next((cutoff for cutoff in asked if cutoff is not None), None)
        if cutoff is not None:
            cutoffs[kind] = cutoff
        elif jobs:
            wrong[kind] = RecordingError(
                f"none of its first {len(jobs)} recordings determines a cut-off",
                where=kind,
                cure="check these with `deltaid check`, or give --cutoff",
            )
    if cutoffs != known:
        place.write(DECIDED, json.dumps({"cutoff_hz": cutoffs}, indent=2).encode())
    return replace(plan, cutoffs=cutoffs, wrong=wrong, hows={})


def suggested_cutoff(job: GatherJob) -> float | None:
    """The cut-off that a recording asks for [Hz], of two digits; None where it cannot be used."""
    with ALONE, threads(1):
        try:
            with local_file(job.recorded.path) as path:
                how, kinematics = job.how, Kinematics(job.how.robot)
                log = open_log(path, kinematics, how.mapping, keep_all=how.settings.keep_all)
            cutoff = log.suggested_cutoff
        except (DeltaidError, FileNotFoundError):
            return None
    return None if cutoff is None else float(f"{cutoff:.2g}")


def _jobs(plan: GatherPlan, fleet: Fleet, kind: str) -> Iterator[GatherJob]:
    recordings = [recorded for recorded in fleet.recordings if recorded.type == kind]
    for recorded in sorted(recordings, key=lambda recorded: (recorded.time, recorded.path)):
        with suppress(DeltaidError):
            yield GatherJob(recorded, plan.how(recorded))


def _decided(place: Place) -> dict[str, float]:
    data = place.read(DECIDED)
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
