"""`deltaid drift`: friction over weeks and months, from factor files."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.drift_options import FalseAlarms, Limit, Since, drift_settings
from deltaid.cli.options import AsJson, output_file

if TYPE_CHECKING:
    from deltaid.fleets.factor_file import FactorFile
    from deltaid.fleets.robot_drift import RobotDrift
    from deltaid.model.record import IdentifiedModel


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("drift")(drift)


def drift(
    robot: Annotated[
        str, typer.Argument(help="Catalogue name, a robot file, or a model of this robot.")
    ],
    factors: Annotated[
        list[Path], typer.Argument(help="Files of `deltaid gather`, or their folder.")
    ],
    limit: Limit = None,
    false_alarms: FalseAlarms = 0.1,
    since: Since = None,
    output: Annotated[
        Path | None,
        output_file("--output", "-o", help="Table of what was found (.parquet or .csv)."),
    ] = None,
    friction: Annotated[
        Path | None, output_file(help="Table of each recording's friction (.parquet or .csv).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find friction that changes: since when, how fast, and when it reaches a limit.

    Temperature and load are taken out. docs/drift.md says what alarms rest on.
    """
    from deltaid.cli.gathered import in_folders
    from deltaid.cli.output import console, print_json, progress, require_outputs, shown
    from deltaid.errors import DeltaidError
    from deltaid.fleets.drift_inputs import recorded
    from deltaid.fleets.drift_tables import (
        drift_shown,
        drift_table,
        friction_table,
        require_table,
        save,
        sentences,
    )
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.robot_drift import robot_drift

    settings = drift_settings(limit, false_alarms, since)
    paths = in_folders(factors)
    for path in paths:
        if path.is_dir():
            raise DeltaidError(
                "holds no factor files", where=str(path), cure="make some with `deltaid gather`"
            )
    require_outputs(paths, {"--output": output, "--friction": friction})
    writers = {path: table for path, table in ((output, drift_table), (friction, friction_table))
               if path is not None}  # fmt: skip
    for path in writers:
        require_table(path)
    with progress(as_json) as say:
        files = list["FactorFile"]()
        for k, path in enumerate(paths):
            say(f"reading {k + 1} of {len(paths)}")
            files.append(read(path))
        say("looking for drift")
        known = _model(robot, files)
        found = robot_drift(recorded(files), known, settings)
    for path, table in writers.items():
        save(table([found]), path)
    if as_json:
        print_json(as_dictionary(found))
        return
    console.print(shown(drift_shown(found)))
    console.print()
    for text in sentences(found):
        console.print(text, markup=False, highlight=False, soft_wrap=True)
    for path in writers:
        console.print(f"wrote {path}")


def _model(robot: str, files: "Sequence[FactorFile]") -> "IdentifiedModel":
    """A model by its file; else what the recordings say together."""
    from deltaid.fleets.identify_gathered import identify_gathered
    from deltaid.model.model import load
    from deltaid.robot.load import described

    known = load(robot).identified
    return identify_gathered(described(robot), files).model if known is None else known


def as_dictionary(found: "RobotDrift") -> dict[str, Any]:
    """What was found as one JSON object."""
    from deltaid.fleets.drift_tables import drift_table

    rows = drift_table([found]).to_dicts()
    for row in rows:
        row |= {key: _told(value) for key, value in row.items()}
    common = ("robot", "false_alarms", "tool_change", "tool_mass")
    return {
        "robot": found.robot,
        "recordings": len(found.recordings),
        "first": _told(found.recordings[0].time),
        "last": _told(found.recordings[-1].time),
        "false_alarms": found.bound,
        "tool_changes": [
            {"day": _told(found.date(one.day)), "mass": one.mass, "std": one.std}
            for one in found.tools
        ],
        "drives": [{k: v for k, v in row.items() if k not in common} for row in rows],
    }


def _told(value: object) -> object:
    """Times as text, all else as it is."""
    from datetime import datetime

    return value.isoformat(timespec="seconds") if isinstance(value, datetime) else value
