"""Steps of a call of `deltaid fleet`: jobs, each with a checksum of all that it follows from.

What the tables hold of a job is not done again, nor is what was refused. A worker keeps what it has
made as a journal until the tables are written, so a call may be ended at any time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import Any, TypeVar

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_plan import GatherPlan
from deltaid.fleets.known import EarlierCalls
from deltaid.fleets.place import Place, ReadOnce
from deltaid.fleets.store import StoreError
from deltaid.fleets.workers import ALONE, Workers
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
class Leaf:
    """A recording that a job reads: its factor file, its checksum, and when it was made."""

    file: str
    sha256: str
    time: datetime


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
        leaves: of a robot, its recordings in the order of time.
        common: of a robot, checksum of all that its fits follow from beside its recordings.
        blocks: of a robot, folder of blocks of merged recordings, seen from the fleet's folder.
    """

    robot: str
    type: str
    names: tuple[str, ...]
    files: tuple[str, ...]
    key: str
    description: RobotDescription
    settings: Settings
    leaves: tuple[Leaf, ...] = ()
    common: str = ""
    blocks: str = ""


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
        read: what a job needs, from the fleet's folder.
        make: tables from a job, what it needs, and the fleet's folder, into which it writes the
            file.
        tables: their columns, by name.
        file: that it leaves behind, seen from the fleet's folder; empty if there is none.
        leads: whether no later step of a robot is done where this one fails.
    """

    what: str
    read: Callable[[Any, Place], Any]
    make: Callable[[Any, Any, Place], Tables]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    file: Callable[[Any], str] = _no_file
    leads: bool = False

    def known(self, call: Call, jobs: Sequence[FleetJob]) -> dict[str, JobResult]:
        """What earlier calls have come to, by key; jobs that are left have none."""
        results = dict[str, JobResult]()
        keys = [frozenset(call.known.tables[name]["key"]) for name in self.tables]
        absent = {self.file(job) for job in jobs} - {""}
        for folder in {file.partition("/")[0] for file in absent}:
            absent.difference_update(call.place.listing(folder))
        for job in jobs:
            if self.file(job) not in absent and all(job.key in known for known in keys):
                results[job.key] = JobResult(job)
            elif job.key in call.known.refused:
                results[job.key] = JobResult(job, reason=call.known.refused[job.key])
        return results

    def finished(self, job: FleetJob, place: Place) -> JobResult | None:
        """What a call that was ended before its end has left of a job; None if it is not done."""
        left = {name: place.finished(_journal(job, name)) for name in self.tables}
        whole = {name: table for name, table in left.items() if table is not None}
        has_file = not (file := self.file(job)) or place.size(file) > 0
        return JobResult(job, whole) if len(whole) == len(left) and has_file else None

    def work(self, job: FleetJob, place: Place) -> JobResult:
        """Do a job, unless a call that was ended before its end has done it.

        What cannot be done has its reason, and is no error.
        """
        if (finished := self.finished(job, place)) is not None:
            return finished
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


# Steps of a robot, each with its job, in the order in which they follow from each other.
Chain = tuple[tuple[FleetStep, FleetJob], ...]
# What became of them, each with what the quarantine calls its step.
ChainResults = list[tuple[str, JobResult]]


def run_chains(
    call: Call, chains: Sequence[Chain], words: tuple[str, str]
) -> tuple[dict[FleetStep, list[JobResult]], dict[FleetStep, int]]:
    """What became of all jobs, by step and in their order, and how many were done now.

    What is left of a chain is done by one worker, which reads each factor file once.

    Args:
        words: what is said, such as 'fitted' 'periods'.
    """
    jobs = dict[FleetStep, list[FleetJob]]()
    for step, job in (link for chain in chains for link in chain):
        jobs.setdefault(step, []).append(job)
    results = {step: step.known(call, asked) for step, asked in jobs.items()}
    by_name = {step.what: step for step in jobs}

    def reached(chain: Chain) -> Chain:
        """The chain as far as its leading steps succeed."""
        for k, (step, job) in enumerate(chain, start=1):
            if step.leads and (known := results[step].get(job.key)) and known.reason:
                return chain[:k]
        return chain

    def failed(chain: Chain, why: str) -> ChainResults:
        """What was done before a worker died of the rest."""
        done: ChainResults = []
        for step, job in chain:
            known = step.finished(job, call.place)
            done.append((step.what, known or JobResult(job, reason=why, lasting=False)))
            if step.leads and known is None:
                break
        return done

    left = [
        tuple((step, job) for step, job in reached(chain) if job.key not in results[step])
        for chain in chains
    ]
    count = dict.fromkeys(jobs, 0)
    for done in call.done(words, work_chain, [chain for chain in left if chain], failed):
        for what, result in done:
            step = by_name[what]
            results[step][result.job.key] = result
            count[step] += 1
    ordered: dict[FleetStep, list[JobResult]] = {step: [] for step in jobs}
    for step, job in (link for chain in chains for link in reached(chain)):
        ordered[step].append(results[step][job.key])
    return ordered, count


def work_chain(chain: Chain, place: Place) -> ChainResults:
    """Jobs one after the other, until a leading one fails."""
    done, place = list[tuple[str, JobResult]](), ReadOnce(place.root)
    with ALONE, threads(1):
        for step, job in chain:
            done.append((step.what, step.work(job, place)))
            if step.leads and done[-1][1].reason:
                break
    return done


class DamagedFactorsError(StoreError):
    """Factor files cannot be read; `files` are their names, seen from the fleet's folder."""

    def __init__(self, files: Sequence[str]) -> None:
        super().__init__(f"{files[0]} is damaged", cure="call again: it is gathered anew")
        self.files = tuple(files)


def _journal(job: FleetJob, table: str) -> str:
    return f"{JOURNAL}/{job.key}-{table}.parquet"
