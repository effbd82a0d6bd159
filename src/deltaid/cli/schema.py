"""`deltaid schema`: JSON Schemas that editors complete and check YAML files with."""

from typing import Annotated, Literal

import typer

Kind = Literal["robot", "columns", "model", "sensors"]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("schema")(schema)


def schema(
    kind: Annotated[
        Kind,
        typer.Argument(help="robot, columns (a log's mapping), model or sensors (what to buy)."),
    ] = "robot",
) -> None:
    """Print the JSON Schema of a file that deltaid reads."""
    from deltaid.cli.output import print_json
    from deltaid.model.record import IdentifiedModel
    from deltaid.planning.offers import Offers
    from deltaid.recording.mapping import ColumnMapping
    from deltaid.robot.description import RobotDescription

    models = {
        "robot": RobotDescription,
        "columns": ColumnMapping,
        "model": IdentifiedModel,
        "sensors": Offers,
    }
    print_json(models[kind].model_json_schema())
