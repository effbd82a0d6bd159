"""`deltaid export`: a model in forms that other programs run."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.export.options import FURTHER, FmiVersion, TargetName


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
    without_friction: Annotated[
        bool, typer.Option("--without-friction", help="Leave all friction out.")
    ] = False,
    fmi: Annotated[FmiVersion, typer.Option("--fmi", help="Version of FMI, of a unit.")] = "2",
) -> None:
    """Write a model as code or as a model of another program.

    docs/export.md says how to use each one, and what friction, gear, units and frames are there.
    """
    from deltaid.cli.output import console, positive, print_warnings, progress
    from deltaid.errors import DeltaidError
    from deltaid.export.files import write_export
    from deltaid.model.model import load
    from deltaid.online.settings import OnlineSettings

    positive("--rate", rate, (10.0, 1e5))
    found = load(model)
    if without_friction:
        found = found.without_friction()
    functions = [name.strip() for name in further.split(",") if name.strip()]
    if rate is not None and "online" not in functions:
        raise DeltaidError(
            "is the rate of the function online, which is not asked for",
            where="--rate",
            cure="add --with online, or leave it out",
        )
    online = OnlineSettings(rate=rate, corner=min(100.0, rate / 5)) if rate else None
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
