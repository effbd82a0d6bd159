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
    ModelOrRobot,
    Report,
    UsePoor,
    bounded,
    names,
    output_file,
    require_outputs,
    require_unset,
)
from deltaid.cli.output import (
    print_outcome,
    print_written,
    progress,
    remark,
    used,
    write_files,
)
from deltaid.errors import DeltaidError, within
from deltaid.exports.options import FURTHER, FmiVersion, TargetName
from deltaid.model.options import lag_of


def export(
    model: ModelOrRobot,
    to: Annotated[TargetName, typer.Option("--to", help="Target format.")],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            help="File to write, or folder (name/) with README and test vectors.",
            metavar="PATH",
        ),
    ],
    single: Annotated[
        bool, typer.Option("--single", help="Generate code in single precision: float, REAL.")
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
        bounded(help="Rate of the function online, Hz. Default: 1000.", limits=(10.0, 1e5)),
    ] = None,
    payload_max: Annotated[
        float | None,
        bounded(
            help="Largest load of the function online, kg. Default: three times the body "
            "that carries it.",
            limits=(1e-3, 1e4),
        ),
    ] = None,
    false_alarms: Annotated[
        float | None,
        typer.Option(help="False contact alarms per hour of the function online. Default: 1."),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(
            help="Constant load at the tool: a mass in kg, or the name of a load "
            "identified with MODEL.",
            metavar="MASS or NAME",
        ),
    ] = None,
    without_friction: Annotated[
        bool, typer.Option("--without-friction", help="Write no friction.")
    ] = False,
    plain_friction: Annotated[
        bool,
        typer.Option(
            "--plain-friction",
            help="Write the nearest viscous and Coulomb friction. A warning reports the error.",
        ),
    ] = False,
    fmi: Annotated[FmiVersion, typer.Option("--fmi", help="FMI version of an FMU.")] = "2",
    force: UsePoor = False,
) -> None:
    """Export a model: C, structured text, FMU, MJCF, …

    docs/export.md describes each target: its use, friction, gears, units and frames.
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
    model: Annotated[str, typer.Argument(help="Saved model of this robot.")],
    log: Annotated[Path, typer.Argument(help="Recording at the controller's rate.")],
    columns: Columns = None,
    gripper: Annotated[
        str | None, typer.Option(help="Column that is 1 while a load is held, otherwise 0.")
    ] = None,
    payload_max: Annotated[
        float | None,
        bounded(help="Largest load, kg. Default: three times the body that carries it."),
    ] = None,
    grip_time: Annotated[
        float, typer.Option(help="Delay from the gripper's signal to grip or release, s.")
    ] = 0.0,
    lag: Annotated[
        str | None,
        typer.Option(
            help="Lag of torques behind positions, ms: one for all drives, one per "
            "drive, or none. Default: the model's.",
            show_default=False,
        ),
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(help="Accepted false contact alarms per hour.")
    ] = 1.0,
    output: Annotated[
        Path | None,
        output_file("--output", "-o", help="Table over time to write (.parquet or .csv)."),
    ] = None,
    report: Report = None,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Detect loads and contacts, cycle by cycle.

    The command processes a recording as a controller would while the robot runs.

    Without a gripper's signal it detects loads from torques alone; a vertical push then looks like
    a load.
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
        if not replayed.has_gripper:
            require_unset({"--grip-time": grip_time != 0.0}, "--gripper COLUMN")
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
            "has_gripper": watched.has_gripper,
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
        [view.verdict(watched).sentence, *view.result_lines(watched)],
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
