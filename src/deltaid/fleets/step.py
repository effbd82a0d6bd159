"""Steps of a call of `deltaid fleet`: jobs, each with a checksum of all that it follows from.

What the tables hold of a job is not done again, nor is what was refused. A worker keeps what it has
made as a journal until the tables are written, so a call may be ended at any time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.cluster import ALONE
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_plan import GatherPlan
from deltaid.fleets.known import EarlierCalls
from deltaid.fleets.place import Place
from deltaid.fleets.pool import Workers
from deltaid.fleets.store import StoreError
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.robot.description import RobotDescription

# Folder of what jobs have made and no table holds yet.
JOURNAL = "unfinished"

Say = Callable[[str], None]
Tables = dict[str, pl.DataFrame]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Call:
    """What all steps of a call have in common.

    Attributes:
        fleet: what there is.
        place: the fleet's folder.
        plan: how recordings are gathered.
        known: what earlier calls have come to.
        workers: who do it, and start when they are asked for.
        say: told of every step.
        drop_absent: forget recordings that are not there and cannot be used as asked.
        regather: gather those anew that were gathered otherwise.
    """

    fleet: Fleet
    place: Place
    plan: GatherPlan
    known: EarlierCalls
    workers: Callable[[], Workers]
    say: Say
    drop_absent: bool = False
    regather: bool = False

    def done(
        self,
        words: tuple[str, str],
        work: Callable[..., _Result],
        jobs: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """Jobs that are left, done by workers, in whatever order.

        Args:
            words: what is said, such as 'gathered' 'recordings'.
            work: a job, and the fleet's folder as `place`, to a result.
            failed: the result of a job that nobody could do.
        """
        if not jobs:
            return
        self.say(f"{words[0]} 0 of {len(jobs)} {words[1]}")
        task = partial(work, place=self.place)
        for k, result in enumerate(self.workers().done(task, jobs, failed), start=1):
            yield result
            self.say(f"{words[0]} {k} of {len(jobs)} {words[1]}")


@dataclass(frozen=True)
class FleetJob:
    """A robot in some periods, a robot in all of them, or a type.

    Attributes:
        robot: whose; empty for a type.
        type: as the manifest has it.
        names: what the job is of: periods that have the same recordings, or the type.
        files: that it reads, seen from the fleet's folder; of recordings in the order of time.
        key: checksum of all that the result follows from.
        description: of the robot or type.
        settings: of the fit.
    """

    robot: str
    type: str
    names: tuple[str, ...]
    files: tuple[str, ...]
    key: str
    description: RobotDescription
    settings: Settings


@dataclass(frozen=True)
class JobResult:
    """What became of a job.

    Attributes:
        job: which.
        tables: by name, such as 'parameters', if they were made in this call.
        reason: why there is nothing; empty if there is.
        lasting: whether another call would end the same.
        damaged: factor files that cannot be read, and have to be gathered again.
    """

    job: FleetJob
    tables: Tables = field(default_factory=dict)
    reason: str = ""
    lasting: bool = True
    damaged: tuple[str, ...] = ()


def _no_file(job: FleetJob) -> str:
    del job
    return ""


@dataclass(frozen=True, eq=False)
class FleetStep:
    """What is done with every robot or type once recordings have been gathered.

    Attributes:
        what: as the quarantine calls it.
        words: for progress, such as 'fitted' 'periods'.
        read: what a job needs, from the fleet's folder.
        make: tables from a job, what it needs, and the fleet's folder, into which it writes the
            file.
        tables: their columns, by name.
        file: that it leaves behind, seen from the fleet's folder; empty if there is none.
    """

    what: str
    words: tuple[str, str]
    read: Callable[[Any, Place], Any]
    make: Callable[[Any, Any, Place], Tables]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    file: Callable[[Any], str] = _no_file

    def run(self, call: Call, jobs: Sequence[FleetJob]) -> tuple[list[JobResult], int]:
        """What became of all jobs, in their order, and how many were done now."""
        results = dict[str, JobResult]()
        keys = [frozenset(call.known.tables[name]["key"]) for name in self.tables]
        absent = {self.file(job) for job in jobs} - {""}
        for folder in {file.partition("/")[0] for file in absent}:
            absent.difference_update(call.place.listing(folder))
        for job in jobs:
            if self.file(job) not in absent and all(job.key in own for own in keys):
                results[job.key] = JobResult(job)
            elif job.key in call.known.refused:
                results[job.key] = JobResult(job, reason=call.known.refused[job.key])
        left = [job for job in jobs if job.key not in results]

        def failed(job: FleetJob, why: str) -> JobResult:
            return JobResult(job, reason=why, lasting=False)

        for result in call.done(self.words, self.work, left, failed):
            results[result.job.key] = result
        return [results[job.key] for job in jobs], len(left)

    def work(self, job: FleetJob, place: Place) -> JobResult:
        """Do a job, unless a call that was ended before its end has done it.

        What cannot be done has its reason, and is no error.
        """
        with ALONE, threads(1):
            left = {name: place.finished(_journal(job, name)) for name in self.tables}
            whole = {name: table for name, table in left.items() if table is not None}
            file = self.file(job)
            if len(whole) == len(left) and (not file or place.size(file)):
                return JobResult(job, whole)
            try:
                given = self.read(job, place)
            except DeltaidError as error:
                damaged = error.files if isinstance(error, DamagedFactorsError) else ()
                return JobResult(job, reason=str(error), lasting=False, damaged=damaged)
            try:
                made = {
                    name: table.with_columns(key=pl.lit(job.key))
                    for name, table in self.make(job, given, place).items()
                }
                for name, table in made.items():
                    place.save(_journal(job, name), table)
            except DeltaidError as error:
                return JobResult(job, reason=str(error), lasting=not isinstance(error, StoreError))
        return JobResult(job, made)


class DamagedFactorsError(StoreError):
    """Factor files cannot be read; `files` are their names, seen from the fleet's folder."""

    def __init__(self, files: Sequence[str]) -> None:
        super().__init__(f"{files[0]} is damaged", cure="call again: it is gathered anew")
        self.files = tuple(files)


def read_factors(job: FleetJob, place: Place) -> list[FactorFile]:
    """The factor files of a job.

    Raises:
        DamagedFactorsError: some cannot be read.
    """
    files = {name: place.factors(name) for name in job.files}
    damaged = [name for name, file in files.items() if file is None]
    if damaged:
        raise DamagedFactorsError(damaged)
    return [file for file in files.values() if file is not None]


def _journal(job: FleetJob, table: str) -> str:
    return f"{JOURNAL}/{job.key}-{table}.parquet"
