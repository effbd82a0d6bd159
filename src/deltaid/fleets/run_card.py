"""Card and table of a call of `fleet`."""

import polars as pl

from deltaid.errors import counted
from deltaid.fleets.gather_all import recordings_table
from deltaid.fleets.run import FleetRun
from deltaid.view.show import Card


def fleet_run_card(run: FleetRun) -> Card:
    lines = [f"{line.what} of {line.robot}: {line.reason}" for line in run.quarantine]
    put = [f"{len(run.quarantine)} in quarantine"] * bool(run.quarantine)
    return Card("Fleet", (f"{summary(run)}.", *put, *lines), methods=(".quarantine", ".to_frame()"))


def fleet_run_frame(run: FleetRun) -> pl.DataFrame:
    """One row per recording, as in `recordings.parquet`."""
    return recordings_table(run.outcomes)


def summary(run: FleetRun) -> str:
    """Numbers of robots, recordings and fits, and what this call made of them."""
    used = [outcome for outcome in run.outcomes if outcome.file]
    robots = {outcome.recorded.robot for outcome in used}
    fits = [fit for fit in run.fits if not fit.reason]
    gathered, fitted, _ = run.computed
    return (
        f"{counted(len(robots), 'robot')}, {counted(len(used), 'recording')} "
        f"({gathered} processed now), {counted(len(fits), 'fit')} ({fitted} made now)"
    )
