"""What the robots of a type say together: a task a type, done again only when a robot has news."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleet.gathering import ALONE, digest
from deltaid.fleet.members import unpacked
from deltaid.fleet.place import Place
from deltaid.fleet.store import StoreError
from deltaid.fleet.studies import Studied
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.population.fitted import PopulationSettings, fitted
from deltaid.population.tables import MEMBERS, TYPES, members_table, types_table
from deltaid.robot.description import RobotDescription

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


@dataclass(frozen=True)
class Typed:
    """What became of it.

    Attributes:
        job: which.
        tables: by name.
        reason: why there are none.
        lasting: whether another call would end the same.
    """

    job: TypeJob
    tables: dict[str, pl.DataFrame] = field(default_factory=dict, compare=False)
    reason: str = ""
    lasting: bool = True


def type_jobs(studies: Iterable[Studied]) -> list[TypeJob]:
    """One for each type that has robots."""
    robots: dict[str, list[Studied]] = {}
    for one in studies:
        if "type" not in one.reasons and one.tables:
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
