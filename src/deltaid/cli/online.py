"""`deltaid online`: a recording run through as a controller would run it, cycle by cycle."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, Columns, Full, Report, UsePoor, bounded, lag_of, output_file
from deltaid.cli.output import (
    print_json,
    print_warnings,
    print_written,
    progress,
    require_outputs,
    used,
)
from deltaid.cli.screen import print_found
from deltaid.errors import DeltaidError, within

if TYPE_CHECKING:
    from deltaid.online.events import WeighedLoad
    from deltaid.online.replay import Replay
    from deltaid.online.watch import Watched

# Rate of false alarms, an hour, that is asked for where nothing is said.
_FALSE_ALARMS = 1.0


def online(
    model: Annotated[str, typer.Argument(help="A saved model of this robot.")],
    log: Annotated[Path, typer.Argument(help="A recording at the controller's rate.")],
    columns: Columns = None,
    gripper: Annotated[
        str | None, typer.Option(help="Column that is 1 while something is held, else 0.")
    ] = None,
    payload_max: Annotated[
        float | None, bounded(help="Largest mass that is ever held, kg.")
    ] = None,
    grip_time: Annotated[
        float, typer.Option(help="From the gripper's signal to the load being held, or left, s.")
    ] = 0.0,
    lag: Annotated[
        str | None,
        typer.Option(
            help="How late torques come, ms, one or one a drive; none; the model's by default.",
            show_default=False,
        ),
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(help="False alarms of contact that are accepted in an hour.")
    ] = _FALSE_ALARMS,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Table over time (.parquet or .csv).")
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Find loads and contacts, cycle by cycle.

    It reads a recording as it would be read while the robot runs.

    Without a gripper's signal loads are found from torques alone; a push straight up or down then
    looks like one.
    """
    from deltaid.fleets.drift_tables import require_table, save
    from deltaid.model.model import load
    from deltaid.online.contact import FALSE_ALARMS
    from deltaid.online.replay import open_replay
    from deltaid.online.settings import LONGEST_GRIP, OnlineSettings
    from deltaid.online.watch import watch
    from deltaid.recording.mapping import as_mapping
    from deltaid.view.html import write_page
    from deltaid.view.online import online_page

    within("--grip-time", grip_time, (0.0, LONGEST_GRIP))
    within("--false-alarms", false_alarms, FALSE_ALARMS)
    require_outputs((model, log, columns), {"--output": output, "--report": report})
    if output is not None:
        require_table(output)
    known = load(model)
    delay = None if lag is None else _delay(lag, len(known.robot.drives))
    mapping = as_mapping(columns)
    with used(known, force=force), progress(as_json) as say:
        say(f"checking {log}")
        replay = open_replay(known, log, mapping, gripper, delay)
        settings = OnlineSettings(
            largest_mass=payload_max, false_alarms=false_alarms, grip_time=grip_time
        )
        watched = watch(known, replay, settings, say)
        if output is not None:
            save(watched.series, output)
        if report is not None:
            write_page(online_page(watched, f"{watched.log} with {known.source}"), report)
    print_warnings([f"{log}: {text}" for text in watched.doubts])
    if as_json:
        print_json(_as_dictionary(watched, replay))
    else:
        _print(watched, full)
        print_written(output, report)


def _delay(text: str, drives: int) -> tuple[float, ...]:
    """Lags in s from what `--lag` says."""
    lags = (0.0,) if text == "none" else lag_of(text)
    if isinstance(lags, str) or len(lags) not in (1, drives):
        raise DeltaidError(
            f"must be none, or milliseconds, one number or one for each of {drives} drives, not "
            f"{text!r}",
            where="--lag",
        )
    return lags * drives if len(lags) == 1 else lags


def _print(watched: "Watched", full: bool) -> None:
    from deltaid.view.online import friction_table, loads_table, told_lines, touches_table, verdict

    tables = [
        table(watched)
        for table, rows in (
            (loads_table, watched.loads),
            (touches_table, watched.touches),
            (friction_table, watched.friction),
        )
        if rows
    ]
    print_found([verdict(watched).sentence, *told_lines(watched)], tables, full=full)


def _as_dictionary(watched: "Watched", replay: "Replay") -> dict[str, Any]:
    return {
        "log": watched.log,
        "sha256": replay.log.sha256,
        "cycles": watched.cycles,
        "bad": watched.bad,
        "rate_hz": watched.rate,
        "seconds_a_cycle": watched.seconds,
        "told": watched.told,
        "loads": [_load(load) for load in watched.loads],
        "contacts": [asdict(touch) | {"strength": touch.strength} for touch in watched.touches],
        "friction": [asdict(friction) for friction in watched.friction],
        "false_alarms_an_hour": watched.false_alarms,
        "smallest_force": {"best": watched.best, "worst": watched.worst},
        "warnings": list(watched.doubts),
    }


def _load(load: "WeighedLoad") -> dict[str, Any]:
    soon = None
    if load.soon is not None:
        soon = dict(zip(("value", "low", "high"), load.soon, strict=True))
    entries = [asdict(entry) for entry in load.entries]
    return {"start": load.start, "end": load.end, "mass_soon": soon, "entries": entries}
