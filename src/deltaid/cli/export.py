"""`deltaid export` and `online`: a model for other programs, and its use cycle by cycle."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.options import (
    AsJson,
    Columns,
    Full,
    Report,
    UsePoor,
    bounded,
    names,
    output_file,
)
from deltaid.cli.output import (
    print_outcome,
    print_written,
    progress,
    remark,
    require_outputs,
    used,
    write_files,
)
from deltaid.errors import DeltaidError, within
from deltaid.exports.options import FURTHER, FmiVersion, TargetName
from deltaid.model.options import lag_of


def export(
    model: Annotated[
        str,
        typer.Argument(help="A model saved by `deltaid identify`, or a robot, by its prior."),
    ],
    to: Annotated[TargetName, typer.Option("--to", help="Form to write.")],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="File to write, or folder (name/): with README and test vectors.",
            metavar="PATH",
        ),
    ],
    single: Annotated[
        bool, typer.Option("--single", help="Code in single precision: float, REAL.")
    ] = False,
    further: Annotated[
        str,
        typer.Option(
            "--with",
            metavar="NAME,…",
            help=f"Further functions of code: {', '.join(FURTHER)}.",
        ),
    ] = "",
    rate: Annotated[
        float | None,
        bounded(help="Cycles a second of the function online; 1000.", limits=(10.0, 1e5)),
    ] = None,
    payload_max: Annotated[
        float | None,
        bounded(help="Largest mass that the function online expects, kg.", limits=(1e-3, 1e4)),
    ] = None,
    false_alarms: Annotated[
        float | None, typer.Option(help="False alarms of contact an hour, of the same; 1.")
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(
            help="What the tool holds all the time: a mass in kg, or a load that MODEL was "
            "identified with, by its name.",
            metavar="MASS or NAME",
        ),
    ] = None,
    without_friction: Annotated[
        bool, typer.Option("--without-friction", help="Leave all friction out.")
    ] = False,
    plain_friction: Annotated[
        bool,
        typer.Option(
            "--plain-friction",
            help="The nearest viscous and Coulomb friction; a warning states its error.",
        ),
    ] = False,
    fmi: Annotated[FmiVersion, typer.Option("--fmi", help="Version of FMI, of a unit.")] = "2",
    force: UsePoor = False,
) -> None:
    """Export a model: C, structured text, FMU, MJCF, …

    docs/export.md says how to use each one, and what friction, gear, units and frames are there.
    """
    functions = names(further)
    online = _online(functions, rate, payload_max, false_alarms)
    known = deltaid.load(model)
    with used(known, force=force), progress(False) as say:
        written = deltaid.export(
            known,
            to,
            output,
            (Path(model),),
            payload=payload,
            without_friction=without_friction,
            plain_friction=plain_friction,
            single=single,
            functions=functions,
            online=online,
            fmi=fmi,
            progress=say,
        )
    remark("warning", *written.warnings)
    print_written(*written.paths)


def _online(
    functions: tuple[str, ...],
    rate: float | None,
    payload_max: float | None,
    false_alarms: float | None,
) -> "deltaid.OnlineSettings | None":
    """Settings of the function `online`, where an option gives any.

    Raises:
        DeltaidError: a number is out of bounds, or is of a function that is not asked for.
    """
    from deltaid.online.contact import FALSE_ALARMS

    if false_alarms is not None:
        within("--false-alarms", false_alarms, FALSE_ALARMS)
    given = {"--rate": rate, "--payload-max": payload_max, "--false-alarms": false_alarms}
    said = [option for option, value in given.items() if value is not None]
    if said and "online" not in functions:
        raise DeltaidError(
            "is of the function online, which is not asked for",
            where=said[0],
            cure="add --with online, or leave it out",
        )
    if not said:
        return None
    usual = deltaid.OnlineSettings()
    alarms = usual.false_alarms if false_alarms is None else false_alarms
    return deltaid.OnlineSettings(largest_mass=payload_max, false_alarms=alarms).at_rate(
        rate or usual.rate
    )


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
    ] = 1.0,
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
    from deltaid.online import contact, replay, settings, watch
    from deltaid.view import html
    from deltaid.view import online as view

    within("--grip-time", grip_time, (0.0, settings.LONGEST_GRIP))
    within("--false-alarms", false_alarms, contact.FALSE_ALARMS)
    require_outputs((model, log, columns), {"--output": output, "--report": report})
    if output is not None:
        require_table(output)
    known = deltaid.load(model)
    delay = None if lag is None else _delay(lag, len(known.robot.drives))
    mapping = None if columns is None else deltaid.load_mapping(columns)
    with used(known, force=force), progress(as_json) as say:
        say(f"checking {log}")
        replayed = replay.open_replay(known, log, mapping, gripper, delay)
        asked = deltaid.OnlineSettings(
            largest_mass=payload_max, false_alarms=false_alarms, grip_time=grip_time
        )
        watched = watch.watch(known, replayed, asked, say)
        title = f"{watched.log} with {known.source}"
        write_files(
            (output, lambda path: save(watched.series, path)),
            (report, lambda path: html.write_page(view.online_page(watched, title), path)),
        )
    remark("warning", *(f"{log}: {text}" for text in watched.doubts))
    tables = view.loads_table(watched), view.touches_table(watched), view.friction_table(watched)
    print_outcome(
        as_json,
        {
            "log": watched.log,
            "sha256": replayed.log.sha256,
            "cycles": watched.cycles,
            "bad": watched.bad,
            "rate_hz": watched.rate,
            "seconds_a_cycle": watched.seconds,
            "told": watched.told,
            "loads": [
                {
                    "start": load.start,
                    "end": load.end,
                    "mass_soon": load.soon
                    and dict(zip(("value", "low", "high"), load.soon, strict=True)),
                    "entries": [asdict(entry) for entry in load.entries],
                }
                for load in watched.loads
            ],
            "contacts": [asdict(x) | {"strength": x.strength} for x in watched.touches],
            "friction": [asdict(friction) for friction in watched.friction],
            "false_alarms_an_hour": watched.false_alarms,
            "smallest_force": {"best": watched.best, "worst": watched.worst},
            "warnings": list(watched.doubts),
        },
        [view.verdict(watched).sentence, *view.told_lines(watched)],
        [table for table in tables if table.rows],
        full=full,
        files=(output, report),
    )


def _delay(text: str, drives: int) -> tuple[float, ...]:
    lags = (0.0,) if text == "none" else lag_of(text)
    if isinstance(lags, str) or len(lags) not in (1, drives):
        raise DeltaidError(
            f"must be none, or milliseconds, one number or one for each of {drives} drives, not "
            f"{text!r}",
            where="--lag",
        )
    return lags * drives if len(lags) == 1 else lags
