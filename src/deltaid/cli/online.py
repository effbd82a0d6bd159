"""`deltaid online`: a recording run through as a controller would run it, cycle by cycle."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, output_file

if TYPE_CHECKING:
    from deltaid.model.model import Model
    from deltaid.online.events import Touch, WeighedLoad
    from deltaid.online.replay import Replay
    from deltaid.online.watch import Watched

# Rate of false alarms, an hour, that is asked for where nothing is said.
_FALSE_ALARMS = 1.0


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("online")(online)


def online(
    model: Annotated[str, typer.Argument(help="A saved model of this robot.")],
    log: Annotated[Path, typer.Argument(help="A recording at the controller's rate.")],
    columns: Annotated[
        Path | None, typer.Option(help="Which column is what, and its unit (YAML).")
    ] = None,
    gripper: Annotated[
        str | None, typer.Option(help="Column that is 1 while something is held, else 0.")
    ] = None,
    payload_max: Annotated[
        float | None, typer.Option(help="Largest mass that is ever held, kg.")
    ] = None,
    grip_time: Annotated[
        float, typer.Option(help="From the gripper's signal to the load being held, or left, s.")
    ] = 0.0,
    lag: Annotated[
        str | None,
        typer.Option(
            help="How late torques come, ms, one or one a drive; none; the model's if left out.",
            show_default=False,
        ),
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(help="False alarms of contact that are accepted in an hour.")
    ] = _FALSE_ALARMS,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Table over time (.parquet or .csv).")
    ] = None,
    report: Annotated[
        Path | None, output_file(help="HTML page with figures, works offline.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find payloads and contacts in a recording as it would be found while the robot runs.

    Without a gripper's signal loads are found from torques alone; a push straight up or down then
    looks like one.
    """
    from deltaid.cli.output import print_json, print_warnings, progress, require_outputs
    from deltaid.errors import positive, within
    from deltaid.fleets.drift_tables import require_table, save
    from deltaid.model.model import load
    from deltaid.online.contact import FALSE_ALARMS
    from deltaid.online.replay import open_replay
    from deltaid.online.settings import LONGEST_GRIP, OnlineSettings
    from deltaid.online.watch import over_time, watch
    from deltaid.recording.mapping import load_mapping

    positive("--payload-max", payload_max)
    within("--grip-time", grip_time, (0.0, LONGEST_GRIP))
    within("--false-alarms", false_alarms, FALSE_ALARMS)
    inputs = [Path(model), log, *([columns] if columns else [])]
    require_outputs(inputs, {"--output": output}, report)
    if output is not None:
        require_table(output)
    known = load(model)
    delay = None if lag is None else _delay(lag, len(known.robot.drives))
    mapping = load_mapping(columns) if columns else None
    with progress(as_json) as say:
        say(f"checking {log}")
        replay = open_replay(known, log, mapping, gripper, delay)
        settings = OnlineSettings(
            largest_mass=payload_max, false_alarms=false_alarms, grip_time=grip_time
        )
        found = watch(known, replay, settings, say)
        if output is not None:
            save(over_time(found), output)
        if report is not None:
            _report(found, known, report)
    print_warnings([f"{log}: {text}" for text in found.doubts])
    if as_json:
        print_json(_as_dictionary(found, replay))
    else:
        _print(found, [path for path in (output, report) if path is not None])


def _delay(text: str, drives: int) -> tuple[float, ...]:
    """Lags in s from what `--lag` says."""
    from deltaid.cli.output import lag_of
    from deltaid.errors import DeltaidError

    found = (0.0,) if text == "none" else lag_of(text)
    if isinstance(found, str) or len(found) not in (1, drives):
        raise DeltaidError(
            f"must be none, or milliseconds, one number or one for each of {drives} drives, not "
            f"{text!r}",
            where="--lag",
        )
    return found * drives if len(found) == 1 else found


def _report(found: "Watched", model: "Model", path: Path) -> None:
    from deltaid.view.html import write_page
    from deltaid.view.online import online_page

    write_page(online_page(found, f"{found.log} with {model.source}"), path)


def _print(found: "Watched", written: list[Path]) -> None:
    from deltaid.cli.output import console, shown
    from deltaid.view.online import (
        friction_table,
        loads_table,
        told_lines,
        touches_table,
    )

    if found.loads:
        console.print(shown(loads_table(found)))
    else:
        console.print("no load was found")
    if found.touches:
        console.print(shown(touches_table(found)))
    else:
        console.print("no contact was found")
    if found.friction:
        console.print(shown(friction_table(found)))
    for line in told_lines(found):
        console.print(line)
    for path in written:
        console.print(f"wrote {path}")


def _as_dictionary(found: "Watched", replay: "Replay") -> dict[str, Any]:
    return {
        "log": found.log,
        "sha256": replay.log.sha256,
        "cycles": found.cycles,
        "bad": found.bad,
        "rate_hz": found.rate,
        "seconds_a_cycle": found.seconds,
        "told": found.told,
        "loads": [_load(one) for one in found.loads],
        "contacts": [_touch(one) for one in found.touches],
        "friction": [asdict(one) for one in found.friction],
        "false_alarms_an_hour": found.false_alarms,
        "smallest_force": {"best": found.best, "worst": found.worst},
        "warnings": list(found.doubts),
    }


def _load(one: "WeighedLoad") -> dict[str, Any]:
    soon = None
    if one.soon is not None:
        soon = dict(zip(("value", "low", "high"), one.soon, strict=True))
    entries = [asdict(entry) for entry in one.entries]
    return {"start": one.start, "end": one.end, "mass_soon": soon, "entries": entries}


def _touch(one: "Touch") -> dict[str, Any]:
    return asdict(one) | {"strength": one.strength}
