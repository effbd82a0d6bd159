"""Plan of gathering a fleet: descriptions, mappings, and one filter for each type."""

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
from deltaid.fleets.factor_file import ENDING, digest, gathering_digest, safe
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
from deltaid.robot.load import catalogue, load_robot

FACTORS = "factors"
DECIDED = "decided.json"
# Largest number of a type's recordings that are tried, one after the other, for a cut-off.
_TRIED = 20

_Read = TypeVar("_Read")


@dataclass(frozen=True)
class How:
    """Inputs of gathering a recording.

    Attributes:
        settings: of filter, masks and corrections.
        force: whether to continue after wrong verdicts.
    """

    robot: RobotDescription
    mapping: ColumnMapping | None
    settings: Settings
    force: bool = False

    @cached_property
    def digest(self) -> str:
        """Checksum of all inputs, and of the version of deltaid."""
        return digest(
            [
                gathering_digest(self.robot, self.mapping, self.settings),
                self.force,
                version("deltaid"),
            ]
        )


@dataclass(frozen=True)
class GatherJob:
    """A recording to gather, and its inputs."""

    recorded: Recorded
    how: How

    @cached_property
    def key(self) -> str:
        """Checksum of all inputs, with the stamp instead of the contents of the recording."""
        return digest([self.recorded.path, self.recorded.stamp, self.how.digest])

    @property
    def file(self) -> str:
        """Name of the factor file, relative to the fleet's folder."""
        robot, log = safe(self.recorded.robot), safe(Path(self.recorded.path).stem)
        return f"{FACTORS}/{robot}/{log}-{self.key[:12]}{ENDING}"


@dataclass(frozen=True)
class GatherResult:
    """Outcome of one recording.

    Attributes:
        key: checksum of its factors' inputs; empty if another call may end differently.
        file: its factor file, relative to the fleet's folder; empty if it was refused.
        reason: of its quarantine; empty if it is usable.
        is_new: whether this call processed it.
        bytes: size of the factor file.
        verdicts: names of doubtful and wrong ones.
        how: checksum of how it is gathered; empty if it cannot be.
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
    """Inputs of gathering all recordings, or errors.

    Attributes:
        force: whether to continue after wrong verdicts.
        robots: descriptions, by type.
        mappings: by their names in the manifest.
        cutoffs: of each type [Hz].
        wrong: errors, by type or mapping.
        hows: cache of inputs, by type, mapping and load.
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
        """The plan of a fleet's manifest; unreadable files do not stop the rest."""
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
            fleet.types, lambda path: load_robot(str(path) if str(path) in catalogue() else path)
        )
        mappings = read({name: name for name in fleet.mappings}, load_mapping)
        return cls(settings, force, robots, mappings, {}, wrong)

    def how(self, recorded: Recorded) -> How:
        """Inputs of gathering a recording.

        Raises:
            DeltaidError: its description or mapping is wrong, or both its mapping and the manifest
                declare a load.
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
                # Loads of one name are the same object, so other masses need other names.
                load = Load(always=True, mass=mass, name=f"load-{round(1e6 * mass)}mg")
                mapping = (mapping or ColumnMapping()).changed(load=load)
            self.hows[kind] = How(self.robots[recorded.type], mapping, settings, self.force)
        return self.hows[kind]


def with_cutoffs(
    plan: GatherPlan, fleet: Fleet, place: Place, workers: Callable[[], Workers]
) -> GatherPlan:
    """The plan with a cut-off for each type.

    Only recordings with the same filter can be merged. Without a given cut-off, the first usable
    recording decides for its type, once; the file `decided.json` keeps the result.
    """
    if plan.settings.cutoff is not None:
        return plan
    known = _decided(place)
    wrong, cutoffs = dict(plan.wrong), dict(known)
    for kind in (kind for kind in plan.robots if kind not in known):
        jobs = [*islice(_jobs(plan, fleet, kind), _TRIED)]
        suggested = (
            next(iter(workers().done(suggested_cutoff, [job], lambda *_: None))) for job in jobs
        )
        cutoff = next((cutoff for cutoff in suggested if cutoff is not None), None)
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
    """The cut-off that suits a recording [Hz], with two digits; None if it cannot be used."""
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
