"""What the robots of a type say together: a job a type, done again only when a robot has news."""

from collections.abc import Iterable
from importlib.metadata import version

import polars as pl

from deltaid.fleets.keys import digest, safe
from deltaid.fleets.member import TypeMember, read_member
from deltaid.fleets.next_robot import save_next
from deltaid.fleets.place import Place
from deltaid.fleets.population import MEMBERS, TYPES, members_table, types_table
from deltaid.fleets.step import FleetJob, FleetStep, JobResult, StepPart, Tables
from deltaid.fleets.study_step import member_file
from deltaid.fleets.type_fit import PopulationSettings, fitted

TABLES = {"types": {**TYPES, "key": pl.String}, "members": {**MEMBERS, "key": pl.String}}


def type_jobs(studies: Iterable[JobResult]) -> list[FleetJob]:
    """One for each type that has robots."""
    types: dict[str, list[FleetJob]] = {}
    for study in studies:
        if "type" not in study.reasons:
            types.setdefault(study.job.type, []).append(study.job)
    jobs = list[FleetJob]()
    for kind, robots in sorted(types.items()):
        key = digest([version("deltaid"), kind, sorted(robot.key for robot in robots)])
        files, first = tuple(map(member_file, robots)), robots[0]
        jobs.append(FleetJob("", kind, (kind,), files, key, first.description, first.settings))
    return jobs


def next_robot_file(job: FleetJob) -> str:
    """Where the description of the next robot of a type is."""
    return f"types/{safe(job.type.removesuffix('.yaml'))}.yaml"


def _read(job: FleetJob, place: Place) -> list[TypeMember]:
    return [
        read_member(place.store.read(place.path_to(name)) or b"", place.path_to(name))
        for name in job.files
    ]


def _fit(job: FleetJob, members: list[TypeMember], place: Place) -> Tables:
    """The type's mean and spreads, and its robots within it; the next robot's description."""
    population = fitted(members, job.description, PopulationSettings(fit=job.settings))
    fleet = place.root.rpartition("/")[2]
    place.save_file(next_robot_file(job), lambda path: save_next(population, fleet, path))
    tables = {
        "types": types_table(job.type, population),
        "members": members_table(job.type, population),
    }
    return {
        name: table.with_columns(key=pl.lit(job.key)).select(*TABLES[name])
        for name, table in tables.items()
    }


TYPE_FITS = FleetStep(
    ("compared", "types"), _read, {"type": StepPart(_fit, TABLES, next_robot_file)}
)
