"""`deltaid online`: a recording run through as a controller would run it, cycle by cycle."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import deltaid
from deltaid.cli.options import AsJson, Columns, Full, Report, UsePoor, bounded, lag_of, output_file
from deltaid.cli.output import print_found, print_json, print_warnings, progress, used
from deltaid.cli.output_files import print_written, require_outputs, write_files
from deltaid.errors import DeltaidError, within

if TYPE_CHECKING:
    from deltaid.online.events import WeighedLoad

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
    from deltaid.online.contact import FALSE_ALARMS
    from deltaid.online.replay import open_replay
    from deltaid.online.settings import LONGEST_GRIP
    from deltaid.online.watch import watch
    from deltaid.view import online as view
    from deltaid.view.html import write_page

    within("--grip-time", grip_time, (0.0, LONGEST_GRIP))
    within("--false-alarms", false_alarms, FALSE_ALARMS)
    require_outputs((model, log, columns), {"--output": output, "--report": report})
    if output is not None:
        require_table(output)
    known = deltaid.load(model)
    delay = None if lag is None else _delay(lag, len(known.robot.drives))
    mapping = None if columns is None else deltaid.load_mapping(columns)
    with used(known, force=force), progress(as_json) as say:
        say(f"checking {log}")
        replay = open_replay(known, log, mapping, gripper, delay)
        settings = deltaid.OnlineSettings(
            largest_mass=payload_max, false_alarms=false_alarms, grip_time=grip_time
        )
        watched = watch(known, replay, settings, say)
        title = f"{watched.log} with {known.source}"
        write_files(
            (output, lambda path: save(watched.series, path)),
            (report, lambda path: write_page(view.online_page(watched, title), path)),
        )
    print_warnings([f"{log}: {text}" for text in watched.doubts])
    if as_json:
        print_json(
            {
                "log": watched.log,
                "sha256": replay.log.sha256,
                "cycles": watched.cycles,
                "bad": watched.bad,
                "rate_hz": watched.rate,
                "seconds_a_cycle": watched.seconds,
                "told": watched.told,
                "loads": [_load(load) for load in watched.loads],
                "contacts": [asdict(x) | {"strength": x.strength} for x in watched.touches],
                "friction": [asdict(friction) for friction in watched.friction],
                "false_alarms_an_hour": watched.false_alarms,
                "smallest_force": {"best": watched.best, "worst": watched.worst},
                "warnings": list(watched.doubts),
            }
        )
    else:
        tables = (
            view.loads_table(watched), view.touches_table(watched), view.friction_table(watched),
        )  # fmt: skip
        print_found(
            [view.verdict(watched).sentence, *view.told_lines(watched)],
            [table for table in tables if table.rows],
            full=full,
        )
        print_written(output, report)


def _load(load: "WeighedLoad") -> dict[str, Any]:
    soon = load.soon and dict(zip(("value", "low", "high"), load.soon, strict=True))
    entries = [asdict(entry) for entry in load.entries]
    return {"start": load.start, "end": load.end, "mass_soon": soon, "entries": entries}


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
