"""What the robots of a type say together: a task a type, done again only when a robot has news."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.gather_one import ALONE
from deltaid.fleets.keys import digest, safe
from deltaid.fleets.members import unpacked
from deltaid.fleets.next_robot import next_robot
from deltaid.fleets.place import Place
from deltaid.fleets.population import MEMBERS, TYPES, members_table, types_table
from deltaid.fleets.store import StoreError
from deltaid.fleets.study_step import Studied
from deltaid.fleets.type_fit import PopulationSettings, fitted
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.robot.description import RobotDescription
from deltaid.robot.yaml_tree import yaml_text

FOLDER = "types"
TABLES = {"types": {**TYPES, "key": pl.String}, "members": {**MEMBERS, "key": pl.String}}


@dataclass(frozen=True)
class TypeJob:
    """A type with its robots.

    Attributes:
        type: as the manifest has it.
        members: files of what each robot tells of it.
        key: checksum of all that follows from.
        description: of the type.
        settings: of the fits.
    """

    type: str
    members: tuple[str, ...] = field(compare=False)
    key: str
    description: RobotDescription = field(compare=False)
    settings: Settings = field(compare=False)

    @property
    def file(self) -> str:
        """Where the description of the next robot of the type is."""
        return type_file(self.type)


@dataclass(frozen=True)
class Typed:
    """What became of it.

    Attributes:
        job: which.
        tables: by name, if they were made in this call.
        reason: why there are none.
        lasting: whether another call would end the same.
    """

    job: TypeJob
    tables: dict[str, pl.DataFrame] = field(default_factory=dict, compare=False)
    reason: str = ""
    lasting: bool = True


def type_file(kind: str) -> str:
    """Where the description of the next robot of a type is."""
    return f"{FOLDER}/{safe(kind.removesuffix('.yaml'))}.yaml"


def described_text(robot: RobotDescription) -> str:
    """A description as YAML."""
    return yaml_text(robot.model_dump(mode="json", exclude_none=True))


def type_jobs(studies: Iterable[Studied]) -> list[TypeJob]:
    """One for each type that has robots."""
    robots: dict[str, list[Studied]] = {}
    for one in studies:
        if "type" not in one.reasons:
            robots.setdefault(one.job.type, []).append(one)
    return [_job(kind, own) for kind, own in sorted(robots.items())]


def fit_type(job: TypeJob, place: Place) -> Typed:
    """Fit a type to its robots. What cannot be fitted has its reason, and is no error."""
    with ALONE, threads(1):
        try:
            members = [
                unpacked(place.store.read(place.at(name)) or b"", place.at(name))
                for name in job.members
            ]
            found = fitted(members, job.description, PopulationSettings(fit=job.settings))
            robot = next_robot(found, place.root.rpartition("/")[2])
            place.store.write(place.at(job.file), described_text(robot).encode())
        except DeltaidError as error:
            return Typed(job, {}, str(error), not isinstance(error, StoreError))
    tables = {"types": types_table(job.type, found), "members": members_table(job.type, found)}
    return Typed(
        job,
        {
            name: table.with_columns(key=pl.lit(job.key)).select(*TABLES[name])
            for name, table in tables.items()
        },
    )


def _job(kind: str, own: Sequence[Studied]) -> TypeJob:
    first = own[0].job
    known = [version("deltaid"), kind, sorted(one.job.key for one in own)]
    files = tuple(one.job.member_file for one in own)
    return TypeJob(kind, files, digest(known), first.description, first.settings)
