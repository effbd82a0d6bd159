"""A fleet from its manifest to its tables: gathered and fitted; what is done is not done again."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from deltaid.fleets.cluster import client, require_shared
from deltaid.fleets.drift_settings import DriftSettings
from deltaid.fleets.fit_step import JOURNAL, PARAMETERS, SCHEMA, Fitted
from deltaid.fleets.fleet import Fleet
from deltaid.fleets.gather_all import (
    fit_all,
    gather_again,
    gather_all,
    how_digest,
    study_all,
    type_all,
)
from deltaid.fleets.gather_one import Outcome
from deltaid.fleets.gather_plan import Ways, with_cutoffs
from deltaid.fleets.known import (
    QUARANTINE,
    RECORDINGS,
    Known,
    Quarantined,
    absent_line,
    quarantine_csv,
    recordings_table,
)
from deltaid.fleets.place import Place
from deltaid.fleets.site.site import SITE
from deltaid.fleets.site.site import write as write_site
from deltaid.fleets.step import Call, Say
from deltaid.fleets.store import Store
from deltaid.fleets.study_step import MEMBERS, TABLES, Studied
from deltaid.fleets.type_step import TABLES as TYPE_TABLES
from deltaid.fleets.type_step import Typed
from deltaid.model.record import Settings

if TYPE_CHECKING:
    from distributed import Client


_Done = Fitted | Studied | Typed
_TABLES = (PARAMETERS, *TABLES, *TYPE_TABLES)


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

    outcomes: tuple[Outcome, ...]
    fits: tuple[Fitted, ...]
    studies: tuple[Studied, ...]
    types: tuple[Typed, ...]
    quarantine: tuple[Quarantined, ...]
    computed: tuple[int, int, int]

    @property
    def site(self) -> str:
        """The first of its pages, seen from the folder; empty where there is nothing to show."""
        return f"{SITE}/index.html" if any(one.file for one in self.outcomes) else ""


def run_fleet(
    fleet: Fleet,
    folder: str | Path,
    *,
    settings: Settings | None = None,
    drift: DriftSettings | None = None,
    store: Store | None = None,
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
    settings, place = settings or Settings(), Place.of(folder, store or Store())
    place.require()
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

        call = Call(
            fleet, place, with_cutoffs(ways, fleet, place, started), known, started, progress
        )
        outcomes, gathered = gather_all(call)
        fits, fitted = fit_all(call, outcomes)
        damaged = {name for one in fits for name in one.damaged}
        if damaged:
            outcomes, more = gather_again(call, outcomes, damaged)
            fits, again = fit_all(call, outcomes)
            gathered, fitted = gathered + more, fitted + again
        studies, studied = study_all(call, fits, outcomes, drift or DriftSettings())
        types, _ = type_all(call, studies)
    finished = FleetRun(
        tuple(outcomes),
        tuple(fits),
        tuple(studies),
        tuple(types),
        tuple(_quarantine(fleet, outcomes, fits, studies, types)),
        (gathered, fitted, studied),
    )
    progress("writing tables")
    _write(call, finished)
    if finished.site:
        progress("writing the site")
        _write_site(place)
    return finished


def _quarantine(
    fleet: Fleet,
    outcomes: Sequence[Outcome],
    fits: Sequence[Fitted],
    studies: Sequence[Studied],
    types: Sequence[Typed],
) -> Iterable[Quarantined]:
    there = {(one.recorded.robot, one.recorded.path) for one in outcomes if one.file}
    yield from (absent_line(one) for one in fleet.absent if (one.robot, one.path) not in there)
    for one in outcomes:
        if one.reason:
            who = one.recorded
            yield Quarantined("recording", who.robot, who.path, one.reason, one.key)
    for one in fits:
        if one.reason:
            key = one.job.key * one.lasting
            for period in one.job.periods:
                yield Quarantined("fit", one.job.robot, period, one.reason, key)
    for one in studies:
        for what, reason in one.reasons.items():
            yield Quarantined(what, one.job.robot, one.job.type, reason, one.job.key * one.lasting)
    for one in types:
        if one.reason:
            yield Quarantined("type", "", one.job.type, one.reason, one.job.key * one.lasting)


def _write(call: Call, run: FleetRun) -> None:
    """The tables; what tasks have left behind is then no longer needed."""
    place = call.place
    how = {one.recorded: how_digest(call, one.recorded) for one in run.outcomes}
    steps: tuple[tuple[Sequence[_Done], Mapping[str, Mapping[str, Any]]], ...] = (
        (run.fits, {PARAMETERS: SCHEMA}),
        (run.studies, TABLES),
        (run.types, TYPE_TABLES),
    )
    for done, tables in steps:
        keys = [one.job.key for one in done]
        for name, schema in tables.items():
            new = {one.job.key: one.tables[name] for one in done if name in one.tables}
            place.save(f"{name}.parquet", call.known.with_new(name, schema, keys, new))
    place.save(RECORDINGS, recordings_table(run.outcomes, how))
    place.store.write(place.at(QUARANTINE), quarantine_csv(run.quarantine))
    for name in place.store.listing(place.at(JOURNAL)):
        place.store.remove(place.at(f"{JOURNAL}/{name}"))
    used = {one.job.member_file for one in run.studies}
    for name in place.store.listing(place.at(MEMBERS)):
        if f"{MEMBERS}/{name}" not in used:
            place.store.remove(place.at(f"{MEMBERS}/{name}"))


def _write_site(place: Place) -> None:
    """The pages; of a fleet in a store they are made here and copied there."""
    if place.is_local:
        write_site(Path(place.root))
        return
    with TemporaryDirectory(prefix="deltaid-") as name:
        folder = Path(name)
        for table in (*(f"{one}.parquet" for one in _TABLES), RECORDINGS, QUARANTINE):
            data = place.store.read(place.at(table))
            if data is not None:
                (folder / table).write_bytes(data)
        write_site(folder, place.root.rstrip("/").rpartition("/")[2])
        for page in sorted((folder / SITE).rglob("*")):
            if page.is_file():
                at = page.relative_to(folder).as_posix()
                place.store.write(place.at(at), page.read_bytes())
