"""Run a fleet from its manifest to its tables and pages; finished work is not repeated."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import polars as pl

from deltaid.errors import within
from deltaid.files import require_writable
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.fleet import Fleet, Quarantined, find_fleet
from deltaid.fleets.gather_all import gather_again, gather_all, recordings_table
from deltaid.fleets.gather_plan import GatherPlan, GatherResult, with_cutoffs
from deltaid.fleets.place import BEFORE, JOURNAL, QUARANTINE, RECORDINGS, Place
from deltaid.fleets.site.site import SITE, write_site
from deltaid.fleets.step import Call, FleetStep, JobResult, run_chains
from deltaid.fleets.steps import (
    DRIFTS,
    FITS,
    MEMBERS_FOLDER,
    ROBOTS,
    STEPS,
    TABLES,
    TYPE_FITS,
    fit_jobs,
    robot_chains,
    type_chains,
)
from deltaid.fleets.workers import Workers, open_workers
from deltaid.forked import require_threads
from deltaid.model.options import Period
from deltaid.model.settings import Settings, settings_of
from deltaid.progress import Watch, watched
from deltaid.shown import Shown, Tabled


@dataclass(frozen=True, repr=False)
class FleetRun(Shown, Tabled):
    """Results of a call.

    Attributes:
        outcomes: of all recordings, sorted by robot and time.
        fits: of all periods.
        studies: of all robots.
        types: of all types.
        quarantine: unusable recordings and failed steps, with reasons.
    """

    outcomes: tuple[GatherResult, ...]
    fits: tuple[JobResult, ...]
    studies: tuple[JobResult, ...]
    types: tuple[JobResult, ...]
    quarantine: tuple[Quarantined, ...]

    @property
    def computed(self) -> tuple[int, int, int]:
        """Number of recordings processed, fits made, and robots studied in this call."""
        gathered, fitted, studied = (
            sum(result.is_new for result in results)
            for results in (self.outcomes, self.fits, self.studies)
        )
        return gathered, fitted, studied

    @property
    def site(self) -> str:
        """The first page of the site, relative to the folder; empty without a site."""
        return f"{SITE}/index.html" if any(outcome.file for outcome in self.outcomes) else ""


def fleet(
    manifest: str | Path | Fleet,
    output: str | Path,
    *,
    period: Period | None = None,
    settings: Settings | None = None,
    drift: DriftSettings | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    force: bool = False,
    retry: bool = False,
    drop_absent: bool = False,
    regather: bool = False,
    progress: Watch = None,
    **options: Any,
) -> FleetRun:
    """Gather the recordings of many robots, fit each robot in each period, and search for drift.

    A call may be interrupted at any time; the same call continues. Results do not depend on the
    number or order of workers, nor on the number of calls. Unusable recordings are quarantined with
    their reasons and stop nothing else.

    Args:
        manifest: a file that lists robots, types and recordings.
        output: folder of factor files and tables, or an address such as "s3://bucket/fleet".
        period: of recordings that are fitted together; None for the manifest's, or week.
        settings: of fits, by value.
        drift: settings of drift.
        scheduler: address of a Dask cluster; None for processes on this machine.
        workers: number of processes; None for one per core.
        force: whether to continue after wrong verdicts.
        retry: whether to retry quarantined recordings.
        drop_absent: whether to forget missing recordings that cannot be used.
        regather: whether to gather recordings anew that were gathered with other settings, mappings
            or descriptions, or by another version.
        progress: as in `identify`.
        options: single settings of fits by name, such as `lag="none"`.

    Raises:
        DeltaidError: gathered factors would be lost, no scheduler answers at the address, workers
            do not see the folder, or the manifest or the folder cannot be used; or this process has
            lost its threads, as in `require_threads`.
    """
    require_threads()
    if workers is not None:
        within("workers", workers, (1, math.inf))
    with watched(progress, "fleet") as say, ExitStack() as stack:
        if not isinstance(manifest, Fleet):
            say("looking for recordings")
            manifest = find_fleet(str(manifest), period)
        settings, place = settings_of(settings, options), Place.named(output)
        if place.is_local:
            require_writable(Path(place.path_to(QUARANTINE)))
        plan = GatherPlan.from_manifest(manifest, settings, force=force)
        tables, reasons = place.tables(TABLES), {} if retry else place.refusals()

        @cache
        def started() -> Workers:
            """Workers, started only if there is work."""
            say("starting workers")
            shared = Path(place.root) if place.is_local else None
            return stack.enter_context(open_workers(scheduler, workers, shared))

        plan = with_cutoffs(plan, manifest, place, started)
        call = Call(manifest, place, plan, tables, reasons, started, say, drop_absent, regather)
        return _run(call, drift or DriftSettings())


def _run(call: Call, drift: DriftSettings) -> FleetRun:
    def robots_done() -> list[JobResult]:
        jobs = fit_jobs(outcomes, call.fleet.period, call.plan.robots, call.plan.settings)
        return run_chains(call, robot_chains(jobs, drift), ("fitted", "periods"))

    outcomes = gather_all(call)
    done = robots_done()
    if damaged := {file for result in done for file in result.damaged}:
        outcomes = gather_again(call, outcomes, damaged)
        done = robots_done()
    robots = [result for result in done if result.job.step.name == ROBOTS.name]
    done += run_chains(call, type_chains(robots), ("compared", "types"))
    results = {
        step: tuple(result for result in done if result.job.step.name == step.name)
        for step in STEPS
    }
    finished = FleetRun(
        outcomes=tuple(outcomes),
        fits=results[FITS],
        studies=results[DRIFTS],
        types=results[TYPE_FITS],
        quarantine=tuple(_quarantine(call.fleet, outcomes, results)),
    )
    call.say("writing tables")
    tables = _write(call, finished, results)
    if finished.site:
        call.say("writing the site")
        write_site(tables, call.place)
    return finished


def _quarantine(
    fleet: Fleet,
    outcomes: Sequence[GatherResult],
    results: Mapping[FleetStep, Sequence[JobResult]],
) -> Iterable[Quarantined]:
    used = {(outcome.recorded.robot, outcome.recorded.path) for outcome in outcomes if outcome.file}
    yield from (absent for absent in fleet.absent if (absent.robot, absent.which) not in used)
    for log, outcome in ((outcome.recorded, outcome) for outcome in outcomes if outcome.reason):
        yield Quarantined("recording", log.robot, log.path, outcome.reason, outcome.key)
    for result in (result for done in results.values() for result in done if result.reason):
        job, key = result.job, result.job.key * result.lasting
        for name in job.names:
            yield Quarantined(job.step.what, job.robot, name, result.reason, key)


def _write(
    call: Call, run: FleetRun, results: Mapping[FleetStep, Sequence[JobResult]]
) -> dict[str, pl.DataFrame]:
    place, tables = call.place, dict[str, pl.DataFrame]()
    for file in (*(f"{name}.parquet" for name in TABLES), QUARANTINE):
        if (before := place.read(file)) is not None:
            place.write(f"{BEFORE}/{file}", before)
    for step, done in results.items():
        keys = list(dict.fromkeys(result.job.key for result in done))
        order = pl.DataFrame({"key": keys}, schema={"key": pl.String})
        for name in step.tables:
            new = {result.job.key: result.tables[name] for result in done if name in result.tables}
            old = call.tables[name].filter(~pl.col("key").is_in(list(new)))
            tables[name] = order.join(
                pl.concat([old, *new.values()]), on="key", how="inner", maintain_order="left_right"
            ).select(old.columns)
    tables[RECORDINGS] = recordings_table(run.outcomes)
    for name, table in tables.items():
        place.save(f"{name}.parquet", table)
    tables["quarantine"] = pl.DataFrame(
        [astuple(line) for line in run.quarantine],
        schema=dict.fromkeys((entry.name for entry in fields(Quarantined)), pl.String),
        orient="row",
    )
    place.write(QUARANTINE, tables["quarantine"].write_csv().encode())
    used = {robot.job.file for robot in results[ROBOTS]}
    place.remove({**place.listing(JOURNAL), **place.listing(MEMBERS_FOLDER)}.keys() - used)
    return tables
