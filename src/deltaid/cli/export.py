"""`deltaid export`: a model in forms that other programs run."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.export.options import FmiVersion, TargetName


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
    without_friction: Annotated[
        bool, typer.Option("--without-friction", help="Leave all friction out.")
    ] = False,
    fmi: Annotated[FmiVersion, typer.Option("--fmi", help="Version of FMI, of a unit.")] = "2",
) -> None:
    """Write a model as code or as a model of another program.

    docs/export.md says how to use each one, and what friction, gear, units and frames are there.
    """
    from deltaid.cli.output import console, print_warnings
    from deltaid.export.files import write_export
    from deltaid.model.model import load

    found = load(model)
    if without_friction:
        found = found.without_friction()
    written = write_export(found, to, output, (Path(model),), fmi=fmi)
    print_warnings(written.warnings)
    console.print(f"wrote {', '.join(str(path) for path in written.paths)}")
