"""`deltaid schema`: JSON Schemas that editors complete and check YAML files with."""

from typing import Annotated, Literal

import typer

from deltaid.cli.output import print_json

Kind = Literal["robot", "columns", "model", "sensors", "fleet", "measurements"]


def schema(
    kind: Annotated[
        Kind,
        typer.Argument(
            help="robot, columns (a log's mapping), model, sensors (what to buy), "
            "fleet or measurements (of poses)."
        ),
    ] = "robot",
) -> None:
    """Print the JSON Schema of a file that deltaid reads."""
    from deltaid.calibration.readings import Measurements
    from deltaid.fleets.manifest import Manifest
    from deltaid.model.record import IdentifiedModel
    from deltaid.recording.mapping import ColumnMapping
    from deltaid.robot.description import RobotDescription
    from deltaid.sensors.planning.offers import Offers

    models = {
        "robot": RobotDescription,
        "columns": ColumnMapping,
        "model": IdentifiedModel,
        "sensors": Offers,
        "fleet": Manifest,
        "measurements": Measurements,
    }
    print_json(models[kind].model_json_schema())
