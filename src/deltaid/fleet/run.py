"""A fleet from its manifest to its tables: gathered and fitted; what is done is not done again."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleet.cluster import client, done, require_shared
from deltaid.fleet.fits import (
    JOURNAL,
    PARAMETERS,
    SCHEMA,
    FitJob,
    Fitted,
    as_known,
    fit_jobs,
    fit_period,
)
from deltaid.fleet.fleet import Fleet, Recorded
from deltaid.fleet.gathering import FACTORS, Job, Outcome, gather_recorded
from deltaid.fleet.known import (
    QUARANTINE,
    RECORDINGS,
    Known,
    Quarantined,
    absent_line,
    quarantine_csv,
    recordings_table,
)
from deltaid.fleet.place import Place
from deltaid.fleet.store import Store
from deltaid.fleet.ways import Ways, with_cutoffs
from deltaid.model.record import Settings

if TYPE_CHECKING:
    from distributed import Client

Say = Callable[[str], None]
Clients = Callable[[], "Client"]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class FleetRun:
    """What a call came to.

    Attributes:
        outcomes: of all recordings, in the order of robots and time.
        fits: of all periods.
        quarantine: what could not be used, and why.
        computed: how many recordings were gathered, and how many fits made, in this call.
    """

    outcomes: tuple[Outcome, ...]
    fits: tuple[Fitted, ...]
    quarantine: tuple[Quarantined, ...]
    computed: tuple[int, int]


def run_fleet(
    fleet: Fleet,
    folder: str | Path,
    *,
    settings: Settings | None = None,
    store: Store | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    force: bool = False,
    retry: bool = False,
    progress: Say = lambda _: None,
    dashboard: Say = lambda _: None,
) -> FleetRun:
    """Gather all recordings of a fleet, and fit every robot in every period.

    It may be ended at any time: the next call does what is left. Results do not depend on the
    number of workers, on their order, nor on the number of calls.

    Args:
        folder: of factors and tables, a path or an address; made if there is none.
        store: where recordings lie.
        scheduler: address of a Dask scheduler; processes of this machine where None.
        workers: how many of these; one a core where None.
        force: go on with what the checks call wrong.
        retry: try again what is in quarantine.
        progress: told of every step, such as 'gathered 3 of 8 recordings'.
        dashboard: told where Dask shows what it does.

    Raises:
        DeltaidError: Dask is not installed, nobody answers, workers do not see the folder, or it
            cannot be written to.
    """
    settings, place = settings or Settings(), Place.of(folder, store or Store())
    ways = Ways.of(fleet, place, settings, force=force)
    known = Known.of(place, retry=retry)
    with ExitStack() as stack:

        @cache
        def started() -> "Client":
            """Workers, which are not started for a call that has nothing to do."""
            progress("starting workers")
            found = stack.enter_context(client(scheduler, workers))
            dashboard(str(found.dashboard_link))
            if place.is_local:
                require_shared(found, Path(place.root))
            return found

        ways = with_cutoffs(ways, fleet, place, started)
        run = _Run(fleet, place, ways, known, started, progress)
        outcomes = run.gathered()
        fits = run.fitted(outcomes)
        again = sorted({name for one in fits for name in one.damaged})
        if again:
            outcomes = run.again(outcomes, again)
            fits = run.fitted(outcomes)
    finished = FleetRun(
        tuple(outcomes),
        tuple(fits),
        _quarantine(fleet, outcomes, fits),
        (run.computed_outcomes, run.computed_fits),
    )
    progress("writing tables")
    _write(place, ways, finished)
    return finished


class _Run:
    """One call: what its steps have in common."""

    def __init__(
        self, fleet: Fleet, place: Place, ways: Ways, known: Known, client: "Clients", say: Say
    ) -> None:
        self.fleet, self.place, self.ways, self.known = fleet, place, ways, known
        self.client, self.say = client, say
        self.computed_outcomes = self.computed_fits = 0

    def gathered(self) -> list[Outcome]:
        """What became of all recordings, in their order."""
        listing = {
            f"{FACTORS}/{name}": size
            for name, size in self.place.store.listing(self.place.at(FACTORS)).items()
        }
        outcomes, jobs = list[Outcome](), list[Job]()
        for one in self.fleet.recordings:
            if reason := self.ways.why_not(one):
                outcomes.append(Outcome(one, "", reason=reason, is_new=False))
                continue
            try:
                job = Job.of(one, self.ways.how(one))
            except DeltaidError as error:
                outcomes.append(Outcome(one, "", reason=str(error), is_new=False))
                continue
            there = self.known.gathered(one, job.key, listing)
            if there is not None:
                outcomes.append(there)
            else:
                jobs.append(job)
        outcomes += self._gather(jobs) + self._gone(listing)
        return _once(sorted(outcomes, key=lambda one: one.recorded))

    def again(self, outcomes: Sequence[Outcome], files: Sequence[str]) -> list[Outcome]:
        """The same with some recordings gathered anew, whose factor files are damaged."""
        lost = {one.recorded: one for one in outcomes if one.file in set(files)}
        jobs = [Job.of(one, self.ways.how(one)) for one in lost if one.stamp]
        new = {one.recorded: one for one in self._gather(jobs)}
        gone = {
            one.recorded: replace(
                one, key="", file="",
                reason=f"{one.file} is damaged, and the recording is no longer there",
            )
            for one in lost.values()
        }  # fmt: skip
        return [(gone | new).get(one.recorded, one) for one in outcomes]

    def fitted(self, outcomes: Sequence[Outcome]) -> list[Fitted]:
        """All fits, in the order of robots and periods."""
        jobs = fit_jobs(outcomes, self.fleet.period, dict(self.ways.robots), self.ways.settings)
        there = dict[str, pl.DataFrame]()
        if PARAMETERS in self.known.tables:
            parts = self.known.tables[PARAMETERS].partition_by("key", as_dict=True)
            there = {str(key): part for (key,), part in parts.items()}
        found = dict[FitJob, Fitted]()
        for job in jobs:
            if job.key in there:
                found[job] = as_known(job, {PARAMETERS: there[job.key]})
            elif job.key in self.known.refused:
                found[job] = Fitted(job, reason=self.known.refused[job.key])
        left = [job for job in jobs if job not in found]
        work = partial(fit_period, place=self.place)
        for one in self._done(work, left, lambda job, why: Fitted(job, {}, why, False)):
            found[one.job] = one
            self.computed_fits += 1
            self.say(f"fitted {len(found)} of {len(jobs)} periods")
        return [found[job] for job in jobs]

    def _gather(self, jobs: Sequence[Job]) -> list[Outcome]:
        outcomes, work = list[Outcome](), partial(gather_recorded, place=self.place)
        for one in self._done(work, jobs, lambda job, why: Outcome(job.recorded, "", reason=why)):
            outcomes.append(one)
            self.computed_outcomes += one.is_new
            self.say(f"gathered {len(outcomes)} of {len(jobs)} recordings")
        return outcomes

    def _done(
        self,
        work: Callable[[_Item], _Result],
        items: Sequence[_Item],
        failed: Callable[[_Item, str], _Result],
    ) -> Iterator[_Result]:
        return done(self.client(), work, items, failed) if items else iter(())

    def _gone(self, listing: dict[str, int]) -> list[Outcome]:
        """Recordings that have been gathered, and thrown away since."""
        from fsspec.utils import glob_translate

        named = dict[str, set[str]]()
        for robot, pattern in self.fleet.entries:
            named.setdefault(robot, set()).add(glob_translate(pattern))
        found = list[Outcome]()
        for recorded, outcome, how in self.known.gone(self.fleet.recordings, named, listing):
            if self._how(recorded) == how:
                found.append(outcome)
        return found

    def _how(self, recorded: Recorded) -> str:
        return how_digest(self.ways, recorded)


def how_digest(ways: Ways, one: Recorded) -> str:
    """The checksum of how a recording is gathered; empty where it cannot be."""
    if one.type not in ways.robots or ways.why_not(one):
        return ""
    try:
        return ways.how(one).digest
    except DeltaidError:
        return ""


def _once(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """The same with every recording once: copies would narrow all intervals, telling nothing new.

    What is still there comes before what is not, and the first in order before others.
    """
    found, first = list[Outcome](), dict[str, Recorded]()
    ordered = sorted(outcomes, key=lambda one: (not one.recorded.stamp, one.recorded))
    for one in ordered:
        kept = first.setdefault(one.sha256, one.recorded) if one.file else one.recorded
        if kept == one.recorded:
            found.append(one)
        elif one.recorded.stamp:
            reason = f"is a copy of {kept.path} of {kept.robot}\n  → give each recording once"
            found.append(replace(one, key="", file="", reason=reason))
    return sorted(found, key=lambda one: one.recorded)


def _quarantine(
    fleet: Fleet, outcomes: Sequence[Outcome], fits: Sequence[Fitted]
) -> tuple[Quarantined, ...]:
    there = {(one.recorded.robot, one.recorded.path) for one in outcomes if one.file}
    lines = [absent_line(one) for one in fleet.absent if (one.robot, one.path) not in there]
    lines += [
        Quarantined("recording", one.recorded.robot, one.recorded.path, one.reason, one.key)
        for one in outcomes
        if one.reason
    ]
    lines += [
        Quarantined(
            "fit", one.job.robot, ", ".join(one.job.periods), one.reason, one.job.key * one.lasting
        )
        for one in fits
        if one.reason
    ]
    return tuple(lines)


def _write(place: Place, ways: Ways, run: FleetRun) -> None:
    """The tables; what fits have left behind is then no longer needed."""
    how = {one.recorded: how_digest(ways, one.recorded) for one in run.outcomes}
    tables = [one.tables[PARAMETERS] for one in run.fits if PARAMETERS in one.tables]
    place.save(
        f"{PARAMETERS}.parquet", pl.concat(tables) if tables else pl.DataFrame(schema=SCHEMA)
    )
    place.save(RECORDINGS, recordings_table(run.outcomes, how))
    place.store.write(place.at(QUARANTINE), quarantine_csv(run.quarantine))
    for name in place.store.listing(place.at(JOURNAL)):
        place.store.remove(place.at(f"{JOURNAL}/{name}"))
