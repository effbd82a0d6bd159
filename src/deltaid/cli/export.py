"""`deltaid export`: a model in forms that other programs run."""

from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.options import UsePoor, bounded, names
from deltaid.cli.output import print_warnings, progress, used
from deltaid.cli.output_files import print_written
from deltaid.errors import DeltaidError, within
from deltaid.exports.options import FURTHER, FmiVersion, TargetName


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
    print_warnings(written.warnings)
    print_written(*written.paths)


def _online(
    functions: tuple[str, ...],
    rate: float | None,
    payload_max: float | None,
    false_alarms: float | None,
) -> "deltaid.OnlineSettings | None":
    """What the function online is made for, where something is said about it.

    Raises:
        DeltaidError: a number is out of bounds, or is of a function that is not asked for.
    """
    from deltaid.online.contact import FALSE_ALARMS

    if false_alarms is not None:
        within("--false-alarms", false_alarms, FALSE_ALARMS)
    given = {"--rate": rate, "--payload-max": payload_max, "--false-alarms": false_alarms}
    said = [option for option, value in given.items() if value is not None]
    if not said:
        return None
    if "online" not in functions:
        raise DeltaidError(
            "is of the function online, which is not asked for",
            where=said[0],
            cure="add --with online, or leave it out",
        )
    usual = deltaid.OnlineSettings()
    alarms = usual.false_alarms if false_alarms is None else false_alarms
    return deltaid.OnlineSettings(largest_mass=payload_max, false_alarms=alarms).at_rate(
        rate or usual.rate
    )
