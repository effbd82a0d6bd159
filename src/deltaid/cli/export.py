"""`deltaid export`: a model in forms that other programs run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaid.exports.options import FURTHER, FmiVersion, TargetName

if TYPE_CHECKING:
    from deltaid.model.model import Model
    from deltaid.online.settings import OnlineSettings


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("export")(export)


def export(
    model: Annotated[
        str,
        typer.Argument(help="A model saved by `deltaid identify`, or a robot, by its prior."),
    ],
    to: Annotated[TargetName, typer.Option("--to", help="Form to write.")],
    output: Annotated[
        str,
        typer.Option("--output", "-o", help="File to write, or folder (name/).", metavar="PATH"),
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
        float | None, typer.Option(help="Cycles a second of the function online; 1000.")
    ] = None,
    payload_max: Annotated[
        float | None, typer.Option(help="Largest mass that the function online looks for, kg.")
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
    fmi: Annotated[FmiVersion, typer.Option("--fmi", help="Version of FMI, of a unit.")] = "2",
) -> None:
    """Write a model as code or as a model of another program.

    docs/export.md says how to use each one, and what friction, gear, units and frames are there.
    """
    from deltaid.cli.output import console, print_warnings, progress
    from deltaid.exports.files import write_export
    from deltaid.model.model import load

    functions = [name.strip() for name in further.split(",") if name.strip()]
    online = _online(functions, rate, payload_max, false_alarms)
    found = load(model)
    if payload is not None:
        found = _holding(found, payload)
    if without_friction:
        found = found.without_friction()
    with progress(False) as say:
        written = write_export(
            found,
            to,
            output,
            (Path(model),),
            single=single,
            functions=functions,
            online=online,
            fmi=fmi,
            progress=say,
        )
    print_warnings(written.warnings)
    console.print(f"wrote {', '.join(str(path) for path in written.paths)}")


def _holding(model: "Model", payload: str) -> "Model":
    """A model with what `--payload` says: a load by its name, or kilograms.

    Raises:
        DeltaidError: it is neither.
    """
    from deltaid.cli.output import positive
    from deltaid.control.plant import point_mass
    from deltaid.errors import DeltaidError

    names = [load.name for load in model.identified.loads] if model.identified else []
    if payload in names:
        return model.with_load(payload)
    try:
        mass = float(payload)
    except ValueError:
        what = f"'{payload[:40]}' is no mass, and no load that the model was identified with"
        cure = f"give kilograms, as 1.5{', or one of ' if names else ''}{', '.join(names)}"
        raise DeltaidError(what, where="--payload", cure=cure) from None
    positive("--payload", mass, (1e-6, 1e3))
    return model.with_load(point_mass(mass))


def _online(
    functions: list[str],
    rate: float | None,
    payload_max: float | None,
    false_alarms: float | None,
) -> "OnlineSettings | None":
    """What the function online is made for, where something is said about it.

    Raises:
        DeltaidError: a number is out of bounds, or is of a function that is not asked for.
    """
    from deltaid.cli.output import positive, within
    from deltaid.errors import DeltaidError
    from deltaid.online.contact import FALSE_ALARMS
    from deltaid.online.settings import OnlineSettings

    positive("--rate", rate, (10.0, 1e5))
    positive("--payload-max", payload_max, (1e-3, 1e4))
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
    usual = OnlineSettings()
    alarms = usual.false_alarms if false_alarms is None else false_alarms
    return OnlineSettings(largest_mass=payload_max, false_alarms=alarms).at(rate or usual.rate)
