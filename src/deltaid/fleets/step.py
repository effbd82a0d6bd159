"""Steps of a call of `deltaid fleet`: jobs, each with a checksum of its inputs.

Jobs with results in the tables, or with refusals, are not repeated. Workers write results to a
journal until the tables are written, so a call may be interrupted at any time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_plan import GatherPlan, GatherResult
from deltaid.fleets.place import JOURNAL, Place, Tables
from deltaid.fleets.store import StoreError
from deltaid.fleets.workers import ALONE, Workers
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.progress import Progress
from deltaid.robot.description import RobotDescription

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Call:
    """Common data of all steps of a call.

    Attributes:
        place: the fleet's folder.
        tables: of earlier calls, by name.
        refused: reasons of earlier refusals, by key.
        workers: started by the first request.
        say: called with the text of every step.
        drop_absent: whether to forget missing recordings that cannot be used.
        regather: whether to gather recordings anew that were gathered differently.
    """

    fleet: Fleet
    place: Place
    plan: GatherPlan
    tables: Tables
    refused: Mapping[str, str]
    workers: Callable[[], Workers]
    say: Progress
    drop_absent: bool = False
    regather: bool = False

    def done(
        self,
        words: tuple[str, str],
        work: Callable[..., _Result],
        jobs: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        """Results of jobs by workers, in any order.

        Args:
            words: of the progress, such as 'gathered' 'recordings'.
            work: function of a job, and of the fleet's folder as `place`, that returns a result.
            failed: the result of a job whose workers failed.
        """
        if not jobs:
            return
        self.say(f"{words[0]} 0 of {len(jobs)} {words[1]}")
        task = partial(work, place=self.place)
        for k, result in enumerate(self.workers().done(task, jobs, failed), start=1):
            yield result
            self.say(f"{words[0]} {k} of {len(jobs)} {words[1]}")


@dataclass(frozen=True, eq=False)
class FleetStep:
    """A step for every robot or type after gathering.

    Attributes:
        what: its name in the quarantine.
        read: function that reads a job's input from the fleet's folder.
        make: function of a job, its input and the fleet's folder that writes the file and returns
            tables.
        tables: their columns, by name.
        leads: whether later steps of a robot are skipped if this one fails.
    """

    name: str
    what: str
    read: Callable[[Any, Place], Any]
    make: Callable[[Any, Any, Place], Tables]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    leads: bool = False


@dataclass(frozen=True)
class FleetJob:
    """A step of a robot in some periods, of a robot in all of them, or of a type.

    Attributes:
        robot: its name; empty for a type.
        type: its name in the manifest.
        names: periods with the same recordings, or the type.
        files: inputs, relative to the fleet's folder; of recordings sorted by time.
        key: checksum of the step and its inputs.
        file: output, relative to the fleet's folder; empty if there is none.
        description: of the robot or type.
        recordings: of a robot, sorted by time.
        common: of a robot, checksum of its fits' inputs without recordings.
        blocks: of a robot, folder of blocks of merged recordings, relative to the fleet's folder.
        drift: settings of the search for drift.
    """

    step: FleetStep
    robot: str
    type: str
    names: tuple[str, ...]
    files: tuple[str, ...]
    key: str
    file: str
    description: RobotDescription
    settings: Settings
    recordings: tuple[GatherResult, ...] = ()
    common: str = ""
    blocks: str = ""
    drift: DriftSettings = field(default_factory=DriftSettings)

    def journal(self, table: str) -> str:
        """Journal of one of its tables until the fleet's tables are written."""
        return f"{JOURNAL}/{self.key}-{table}.parquet"


# Jobs of a robot, each of which depends on the previous ones.
Chain = tuple[FleetJob, ...]


@dataclass(frozen=True)
class JobResult:
    """Result of a job.

    Attributes:
        tables: by name, such as 'parameters', if made in this call.
        reason: of a failure; empty on success.
        lasting: whether another call would end in the same way.
        damaged: unreadable factor files that have to be gathered again.
        is_new: whether it was done in this call.
    """

    job: FleetJob
    tables: Tables = field(default_factory=dict)
    reason: str = ""
    lasting: bool = True
    damaged: tuple[str, ...] = ()
    is_new: bool = True


class DamagedFactorsError(StoreError):
    """Factor files cannot be read; `files` are their names, relative to the fleet's folder."""

    def __init__(self, files: Sequence[str]) -> None:
        super().__init__(f"{files[0]} is damaged", cure="call again: it is gathered anew")
        self.files = tuple(files)


def run_chains(call: Call, chains: Sequence[Chain], words: tuple[str, str]) -> list[JobResult]:
    """Results of all jobs, in their order.

    The unfinished part of a chain is done by one worker, which reads each factor file once.

    Args:
        words: of the progress, such as 'fitted' 'periods'.
    """
    results = _known(call, [job for chain in chains for job in chain])
    # Each chain as far as its leading steps succeed.
    known = [_in_turn(chain, lambda job: results.get(job.key)) for chain in chains]
    unfinished = [
        tuple(job for job, result in zip(chain, reached, strict=False) if result is None)
        for chain, reached in zip(chains, known, strict=True)
    ]

    def failed(chain: Chain, why: str) -> list[JobResult]:
        """Results from before the workers died, and failures of the rest."""
        return _in_turn(
            chain,
            lambda job: _finished(job, call.place) or JobResult(job, reason=why, lasting=False),
        )

    for done in call.done(words, work_chain, [chain for chain in unfinished if chain], failed):
        results |= {result.job.key: result for result in done}
    return [result for chain in chains for result in _in_turn(chain, lambda job: results[job.key])]


def _known(call: Call, jobs: Sequence[FleetJob]) -> dict[str, JobResult]:
    """Results of earlier calls, by key."""
    results = dict[str, JobResult]()
    keys = {name: frozenset(table["key"]) for name, table in call.tables.items()}
    absent = {job.file for job in jobs} - {""}
    for folder in {file.partition("/")[0] for file in absent}:
        absent.difference_update(call.place.listing(folder))
    for job in jobs:
        if job.file not in absent and all(job.key in keys[name] for name in job.step.tables):
            results[job.key] = JobResult(job, is_new=False)
        elif reason := call.refused.get(job.key):
            results[job.key] = JobResult(job, reason=reason, is_new=False)
    return results


def _finished(job: FleetJob, place: Place) -> JobResult | None:
    """Result of a job from the journal of an interrupted call; None if it is not finished."""
    try:
        journals = {name: place.table(job.journal(name)) for name in job.step.tables}
    except DeltaidError:  # one is damaged
        return None
    whole = {name: table for name, table in journals.items() if table is not None}
    is_there = not job.file or place.size(job.file) > 0
    return JobResult(job, whole) if len(whole) == len(journals) and is_there else None


def work_chain(chain: Chain, place: Place) -> list[JobResult]:
    """Jobs one after the other, until a leading one fails."""
    with ALONE, threads(1):
        return _in_turn(chain, partial(work, place=Place(place.root)))


def _in_turn(chain: Chain, result_of: Callable[[FleetJob], _Result]) -> list[_Result]:
    """Results of jobs, as far as leading steps succeed."""
    done = list[_Result]()
    for job in chain:
        done.append(result := result_of(job))
        if job.step.leads and isinstance(result, JobResult) and result.reason:
            break
    return done


def work(job: FleetJob, place: Place) -> JobResult:
    """Do a job, unless an interrupted call has done it; a failure is a result with its reason."""
    if (finished := _finished(job, place)) is not None:
        return finished
    try:
        given = job.step.read(job, place)
    except DeltaidError as error:
        damaged = error.files if isinstance(error, DamagedFactorsError) else ()
        return JobResult(job, reason=str(error), lasting=False, damaged=damaged)
    try:
        made = {
            name: table.with_columns(key=pl.lit(job.key))
            for name, table in job.step.make(job, given, place).items()
        }
        for name, table in made.items():
            place.save(job.journal(name), table)
    except DeltaidError as error:
        return JobResult(job, reason=str(error), lasting=not isinstance(error, StoreError))
    return JobResult(job, made)
