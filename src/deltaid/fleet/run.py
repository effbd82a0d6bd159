"""A fleet from its manifest to its tables: gathered and fitted; what is done is not done again."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import polars as pl

from deltaid.files import write_bytes
from deltaid.fleet.cluster import client, done
from deltaid.fleet.gathering import Outcome, gather_recorded
from deltaid.fleet.manifest import Fleet, Recorded
from deltaid.fleet.periods import SCHEMA, Fitted, fit_period, periods_of
from deltaid.fleet.store import Store
from deltaid.model.record import Settings

TABLE, RECORDINGS, QUARANTINE = "parameters.parquet", "recordings.parquet", "quarantine.csv"

Say = Callable[[str], None]


@dataclass(frozen=True)
class FleetRun:
    """What a call came to.

    Attributes:
        outcomes: of all recordings, in the order of robots and time.
        fits: of all periods.
        unmatched: patterns of the manifest that no file answers to.
    """

    outcomes: tuple[Outcome, ...]
    fits: tuple[Fitted, ...]
    unmatched: tuple[str, ...]

    @property
    def refused(self) -> tuple[Outcome, ...]:
        """Recordings in quarantine."""
        return tuple(one for one in self.outcomes if one.reason)


def run_fleet(
    fleet: Fleet,
    folder: Path,
    *,
    settings: Settings | None = None,
    store: Store | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Say = lambda _: None,
) -> FleetRun:
    """Gather all recordings of a fleet, and fit every robot in every period.

    It may be ended at any time: the next call does what is left. Results do not depend on the
    number of workers nor on their order.

    Args:
        folder: of factors, fits and tables; made if there is none.
        store: where recordings lie.
        scheduler: address of a Dask scheduler; processes of this machine where None.
        workers: how many of these; one a core where None.

    Raises:
        DeltaidError: Dask is not installed, nobody answers, or the folder cannot be written to.
    """
    settings, store = settings or Settings(), store or Store()
    folder = folder.resolve()
    with client(scheduler, workers) as found:
        progress(f"gathering {len(fleet.recordings)} recordings; {found.dashboard_link}")
        gather = partial(gather_recorded, folder=folder, settings=settings, store=store)
        outcomes = list[Outcome]()
        for one in done(found, gather, fleet.recordings, _lost):
            outcomes.append(one)
            progress(f"gathered {len(outcomes)} of {len(fleet.recordings)} recordings")
        outcomes.sort(key=lambda one: one.recorded)
        wanted, fits = periods_of(outcomes, fleet.period), list[Fitted]()
        fit = partial(fit_period, folder=folder, settings=settings)
        for one in done(found, fit, wanted, lambda which, why: Fitted(which, reason=why)):
            fits.append(one)
            progress(f"fitted {len(fits)} of {len(wanted)} periods")
    order = {which: k for k, which in enumerate(wanted)}
    fits.sort(key=lambda one: order[one.fit])
    _write(folder, outcomes, fits)
    return FleetRun(tuple(outcomes), tuple(fits), fleet.unmatched)


def _lost(one: Recorded, why: str) -> Outcome:
    return Outcome(one, reason=f"its worker did not come to an end: {why}")


def _write(folder: Path, outcomes: list[Outcome], fits: list[Fitted]) -> None:
    """The tables."""
    tables = [pl.read_parquet(folder / one.table) for one in fits if one.table]
    _save(pl.concat(tables) if tables else pl.DataFrame(schema=SCHEMA), folder / TABLE)
    rows = [
        (one.recorded.robot, one.recorded.time, one.recorded.path, one.recorded.load,
         one.recorded.temperature, one.file, one.reason)
        for one in outcomes
    ]  # fmt: skip
    names = ("robot", "time", "path", "load", "temperature", "file", "reason")
    kinds = (pl.String, pl.Datetime, pl.String, pl.Float64, pl.Float64, pl.String, pl.String)
    recordings = pl.DataFrame(rows, schema=dict(zip(names, kinds, strict=True)), orient="row")
    _save(recordings, folder / RECORDINGS)
    bad = [
        ("recording", one.recorded.robot, one.recorded.path, one.reason)
        for one in outcomes
        if one.reason
    ]
    bad += [("fit", one.fit.robot, one.fit.period, one.reason) for one in fits if one.reason]
    columns = ("what", "robot", "which", "reason")
    frame = pl.DataFrame(bad, schema=dict.fromkeys(columns, pl.String), orient="row")
    write_bytes(folder / QUARANTINE, frame.write_csv().encode())


def _save(frame: pl.DataFrame, path: Path) -> None:
    buffer = BytesIO()
    frame.write_parquet(buffer, compression="zstd")
    write_bytes(path, buffer.getvalue())
