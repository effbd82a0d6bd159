"""Steps of a call of `deltaid fleet`: jobs, each with a checksum of all that it follows from.

What the tables hold of a job is not done again, nor is what was refused. A worker keeps what it has
made as a journal until the tables are written, so a call may be ended at any time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.cluster import ALONE, done
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_plan import GatherPlan
from deltaid.fleets.known import EarlierCalls
from deltaid.fleets.place import Place
from deltaid.fleets.store import StoreError
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.robot.description import RobotDescription

if TYPE_CHECKING:
    from distributed import Client

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
        client: of workers, which start when they are asked for.
        say: told of every step.
    """

    fleet: Fleet
    place: Place
    plan: GatherPlan
    known: EarlierCalls
    client: "Callable[[], Client]"
    say: Say

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
        for k, result in enumerate(done(self.client(), task, jobs, failed), start=1):
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
        reasons: why something is missing, by part: 'fit', 'drift', 'type'.
        lasting: whether another call would end the same.
        damaged: factor files that cannot be read, and have to be gathered again.
    """

    job: FleetJob
    tables: Tables = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    lasting: bool = True
    damaged: tuple[str, ...] = ()


def _no_file(job: FleetJob) -> str:
    del job
    return ""


@dataclass(frozen=True)
class StepPart:
    """A part of what a step makes of a job.

    Attributes:
        make: tables from a job, what it reads, and the fleet's folder, into which it writes the
            file.
        tables: their columns, by name.
        file: that it leaves behind, seen from the fleet's folder; empty if there is none.
    """

    make: Callable[[Any, Any, Place], Tables]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    file: Callable[[Any], str] = _no_file


@dataclass(frozen=True)
class FleetStep:
    """What is done with every robot or type once recordings have been gathered.

    Attributes:
        words: for progress, such as 'fitted' 'periods'.
        read: what all parts need of a job, from the fleet's folder.
        parts: by what the quarantine calls them.
    """

    words: tuple[str, str]
    read: Callable[[Any, Place], Any]
    parts: Mapping[str, StepPart]

    @property
    def tables(self) -> dict[str, Mapping[str, Any]]:
        """Columns of all tables, by name."""
        parts = self.parts.values()
        return {name: columns for part in parts for name, columns in part.tables.items()}

    def run(self, call: Call, jobs: Sequence[FleetJob]) -> tuple[list[JobResult], int]:
        """What became of all jobs, in their order, and how many were done now."""
        results = dict[str, JobResult]()
        rows = {name: call.known.keys(name) for name in self.tables}
        files = {part.file(job) for job in jobs for part in self.parts.values()} - {""}
        for folder in {file.partition("/")[0] for file in files}:
            files.difference_update(call.place.listing(folder))
        for job in jobs:
            missing = [
                what
                for what, part in self.parts.items()
                if part.file(job) in files or any(job.key not in rows[name] for name in part.tables)
            ]
            if not missing:
                results[job.key] = JobResult(job)
            elif job.key in call.known.refused:
                reason = call.known.refused[job.key]
                results[job.key] = JobResult(job, reasons=dict.fromkeys(missing, reason))
        left = [job for job in jobs if job.key not in results]

        def failed(job: FleetJob, why: str) -> JobResult:
            return JobResult(job, reasons=dict.fromkeys(self.parts, why), lasting=False)

        for result in call.done(self.words, self.work, left, failed):
            results[result.job.key] = result
        return [results[job.key] for job in jobs], len(left)

    def work(self, job: FleetJob, place: Place) -> JobResult:
        """Do a job, but for what a call that was ended before its end has done of it.

        What cannot be done has its reason, and is no error.
        """
        tables, reasons, lasting = Tables(), dict[str, str](), True
        with ALONE, threads(1):
            left = dict[str, StepPart]()
            for what, part in self.parts.items():
                finished = _finished(part, job, place)
                if finished is None:
                    left[what] = part
                else:
                    tables |= finished
            try:
                given = self.read(job, place) if left else None
            except DeltaidError as error:
                damaged = error.files if isinstance(error, DamagedFactorsError) else ()
                return JobResult(job, tables, dict.fromkeys(left, str(error)), False, damaged)
            for what, part in left.items():
                try:
                    made = part.make(job, given, place)
                    for name, table in made.items():
                        place.save(_journal(job, name), table)
                    tables |= made
                except DeltaidError as error:
                    reasons[what] = str(error)
                    lasting = lasting and not isinstance(error, StoreError)
        return JobResult(job, tables, reasons, lasting)


class DamagedFactorsError(StoreError):
    """Factor files cannot be read; `files` are their names, seen from the fleet's folder."""

    def __init__(self, files: Sequence[str]) -> None:
        super().__init__(f"{files[0]} is damaged", cure="call again: it is gathered anew")
        self.files = tuple(files)


def read_factors(job: FleetJob, place: Place) -> list[FactorFile]:
    """The factor files of a job.

    Raises:
        DamagedError: some cannot be read.
    """
    files, damaged = list[FactorFile](), list[str]()
    for name in job.files:
        file = place.factors(name)
        if file is None:
            damaged.append(name)
        else:
            files.append(file)
    if damaged:
        raise DamagedFactorsError(damaged)
    return files


def _finished(part: StepPart, job: FleetJob, place: Place) -> Tables | None:
    """What a call that was ended before its end has left of a part; None if not all of it."""
    tables = {name: place.finished(_journal(job, name)) for name in part.tables}
    file = part.file(job)
    if file and not place.size(file):
        return None
    whole = {name: table for name, table in tables.items() if table is not None}
    return whole if len(whole) == len(tables) else None


def _journal(job: FleetJob, table: str) -> str:
    return f"{JOURNAL}/{job.key}-{table}.parquet"
