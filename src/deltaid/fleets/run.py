"""A fleet from its manifest to its tables: gathered and fitted; what is done is not done again."""

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from deltaid.fleets.cluster import client, require_dask, require_shared
from deltaid.fleets.drift_inputs import DriftSettings
from deltaid.fleets.fit_step import FITS, fit_jobs
from deltaid.fleets.fleet import Fleet, find_fleet
from deltaid.fleets.gather_all import (
    gather_again,
    gather_all,
    how_digest,
)
from deltaid.fleets.gather_one import GatherResult
from deltaid.fleets.gather_plan import GatherPlan, with_cutoffs
from deltaid.fleets.known import (
    QUARANTINE,
    RECORDINGS,
    EarlierCalls,
    Quarantined,
    quarantine_csv,
    recordings_table,
)
from deltaid.fleets.place import Place
from deltaid.fleets.site.site import SITE
from deltaid.fleets.site.site import write as write_site
from deltaid.fleets.step import JOURNAL, Call, JobResult, Say
from deltaid.fleets.store import FileStore
from deltaid.fleets.study_step import MEMBERS, STUDIES, member_file, study_jobs
from deltaid.fleets.type_step import TYPE_FITS, type_jobs
from deltaid.model.options import Period
from deltaid.model.settings import Settings, settings_of
from deltaid.progress import Watch, watched

if TYPE_CHECKING:
    from distributed import Client

STEPS = (FITS, STUDIES, TYPE_FITS)


@dataclass(frozen=True)
class FleetRun:
    """What a call came to.

    Attributes:
        outcomes: of all recordings, in the order of robots and time.
        fits: of all periods.
        studies: of all robots.
        types: of all types.
        quarantine: what could not be used, and why.
        computed: how many recordings were looked at, fits made, and robots studied in this call.
    """

    outcomes: tuple[GatherResult, ...]
    fits: tuple[JobResult, ...]
    studies: tuple[JobResult, ...]
    types: tuple[JobResult, ...]
    quarantine: tuple[Quarantined, ...]
    computed: tuple[int, int, int]

    @property
    def site(self) -> str:
        """The first of its pages, seen from the folder; empty where there is nothing to show."""
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
    dashboard: Say = lambda _: None,
    progress: Watch = None,
    **options: Any,
) -> FleetRun:
    """Gather the recordings of many robots, fit each robot in each period, and look for drift.

    It may be ended at any time: the same call does what is left. What cannot be used is put into
    quarantine with its reason and stops nothing else.

    Args:
        manifest: a file that lists robots, types and recordings.
        output: folder of factor files and tables, or an address such as "s3://bucket/fleet".
        period: recordings of which are fitted together; the manifest's, or week, if None.
        settings: of fits, by value.
        drift: what is asked of drift.
        scheduler: address of a Dask cluster; processes on this machine if None.
        workers: how many of these; one a core if None.
        force: go on with what the checks call wrong.
        retry: try again what was put into quarantine before.
        dashboard: called with the address of the cluster's page.
        progress: as of `identify`.
        options: single settings of fits by name, such as `lag="none"`.

    Raises:
        DeltaidError: Dask is missing, or the manifest or the folder cannot be used.
    """
    require_dask()
    store = FileStore()
    with watched(progress, "fleet") as say:
        say("looking for recordings")
        if not isinstance(manifest, Fleet):
            manifest = find_fleet(str(manifest), store, period)
        return run_fleet(
            manifest, output, settings=settings_of(settings, options), drift=drift, store=store,
            scheduler=scheduler, workers=workers, force=force, retry=retry, dashboard=dashboard,
            progress=say,
        )  # fmt: skip


def run_fleet(
    fleet: Fleet,
    folder: str | Path,
    *,
    settings: Settings | None = None,
    drift: DriftSettings | None = None,
    store: FileStore | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    force: bool = False,
    retry: bool = False,
    progress: Say = lambda _: None,
    dashboard: Say = lambda _: None,
) -> FleetRun:
    """Gather all recordings of a fleet, fit every robot in every period, and look for drift.

    It may be ended at any time: the next call does what is left. Results do not depend on the
    number of workers, on their order, nor on the number of calls.

    Args:
        folder: of factors and tables, a path or an address; made if there is none.
        drift: of what is said of drift.
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
    settings, place = settings or Settings(), Place.named(folder, store or FileStore())
    place.require()
    plan = GatherPlan.from_manifest(fleet, place, settings, force=force)
    schemas = {name: columns for step in STEPS for name, columns in step.tables.items()}
    known = EarlierCalls.read(place, schemas, retry=retry)
    with ExitStack() as stack:

        @cache
        def started() -> "Client":
            """Workers, which are not started for a call that has nothing to do."""
            progress("starting workers")
            own = stack.enter_context(client(scheduler, workers))
            dashboard(str(own.dashboard_link))
            if place.is_local:
                require_shared(own, Path(place.root))
            return own

        plan = with_cutoffs(plan, fleet, place, started)
        call = Call(fleet, place, plan, known, started, progress)

        def fit_all() -> tuple[list[JobResult], int]:
            return FITS.run(call, fit_jobs(outcomes, fleet.period, plan.robots, settings))

        outcomes, gathered = gather_all(call)
        fits, fitted = fit_all()
        damaged = {file for fit in fits for file in fit.damaged}
        if damaged:
            outcomes, more = gather_again(call, outcomes, damaged)
            fits, again = fit_all()
            gathered, fitted = gathered + more, fitted + again
        jobs = study_jobs(fits, outcomes, drift or DriftSettings())
        studies, studied = STUDIES.run(call, jobs)
        types, _ = TYPE_FITS.run(call, type_jobs(studies))
    finished = FleetRun(
        tuple(outcomes),
        tuple(fits),
        tuple(studies),
        tuple(types),
        tuple(_quarantine(fleet, outcomes, [*fits, *studies, *types])),
        (gathered, fitted, studied),
    )
    progress("writing tables")
    _write(call, finished)
    if finished.site:
        progress("writing the site")
        _write_site(place)
    return finished


def _quarantine(
    fleet: Fleet, outcomes: Sequence[GatherResult], results: Sequence[JobResult]
) -> Iterable[Quarantined]:
    used = {(outcome.recorded.robot, outcome.recorded.path) for outcome in outcomes if outcome.file}
    for absent in fleet.absent:
        if (absent.robot, absent.path) not in used:
            yield Quarantined("recording", absent.robot, absent.path, absent.reason)
    for outcome in outcomes:
        if outcome.reason:
            recorded = outcome.recorded
            yield Quarantined(
                "recording", recorded.robot, recorded.path, outcome.reason, outcome.key
            )
    for result in results:
        job, key = result.job, result.job.key * result.lasting
        for what, reason in result.reasons.items():
            for name in job.names:
                yield Quarantined(what, job.robot, name, reason, key)


def _write(call: Call, run: FleetRun) -> None:
    """The tables; what jobs have left behind is then no longer needed."""
    place = call.place
    how = {outcome.recorded: how_digest(call, outcome.recorded) for outcome in run.outcomes}
    for step, results in zip(STEPS, (run.fits, run.studies, run.types), strict=True):
        keys = [result.job.key for result in results]
        for name, schema in step.tables.items():
            made = (result for result in results if name in result.tables)
            new = {result.job.key: result.tables[name] for result in made}
            place.save(f"{name}.parquet", call.known.with_new(name, schema, keys, new))
    place.save(RECORDINGS, recordings_table(run.outcomes, how))
    place.store.write(place.path_to(QUARANTINE), quarantine_csv(run.quarantine))
    used = {member_file(study.job) for study in run.studies}
    for name in {**place.listing(JOURNAL), **place.listing(MEMBERS)}:
        if name not in used:
            place.store.remove(place.path_to(name))


def _write_site(place: Place) -> None:
    """The pages; of a fleet in a store they are made here and copied there."""
    if place.is_local:
        write_site(Path(place.root))
        return
    with TemporaryDirectory(prefix="deltaid-") as name:
        folder = Path(name)
        names = [f"{name}.parquet" for step in STEPS for name in step.tables]
        for table in (*names, RECORDINGS, QUARANTINE):
            data = place.store.read(place.path_to(table))
            if data is not None:
                (folder / table).write_bytes(data)
        write_site(folder, place.root.rstrip("/").rpartition("/")[2])
        for page in sorted((folder / SITE).rglob("*")):
            if page.is_file():
                address = place.path_to(page.relative_to(folder).as_posix())
                place.store.write(address, page.read_bytes())
