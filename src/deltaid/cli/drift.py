"""`deltaid drift`: friction over weeks and months, from factor files."""

import os
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.drift_options import FalseAlarms, Limit, Since, drift_settings
from deltaid.cli.gathered import in_folders
from deltaid.cli.options import AsJson, Full, UsePoor, output_file
from deltaid.cli.output import (
    judged,
    print_json,
    print_written,
    progress,
    require_outputs,
)
from deltaid.cli.screen import print_found
from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.fleets.factor_file import FactorFile
    from deltaid.fleets.robot_drift import RobotDrift


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
    full: Full = False,
    as_json: AsJson = False,
    force: UsePoor = False,
) -> None:
    """Find friction that changes over weeks and months.

    Since when, how fast, and when it reaches a limit.

    Temperature and load are taken out. docs/drift.md says what alarms rest on.
    """
    from deltaid.fleets import drift_tables
    from deltaid.fleets.drift_inputs import recorded
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import identify_gathered
    from deltaid.fleets.robot_drift import robot_drift
    from deltaid.model.model import load

    settings = drift_settings(limit, false_alarms, since)
    paths = in_folders(factors)
    for path in paths:
        if os.path.isdir(path):
            raise DeltaidError(
                "holds no factor files", where=str(path), cure="make some with `deltaid gather`"
            )
    require_outputs(paths, {"--output": output, "--friction": friction})
    tables = ((output, drift_tables.drift_table), (friction, drift_tables.friction_table))
    writers = {path: table for path, table in tables if path is not None}
    for path in writers:
        drift_tables.require_table(path)
    model = load(robot)
    with judged(model, force=force), progress(as_json) as say:
        files = list["FactorFile"]()
        for k, path in enumerate(paths):
            say(f"reading {k + 1} of {len(paths)}")
            files.append(read(path))
        say("looking for drift")
        known = model.identified or identify_gathered(model.robot, files).model
        result = robot_drift(recorded(files), known, settings)
    for path, table in writers.items():
        drift_tables.save(table([result]), path)
    if as_json:
        print_json(as_dictionary(result))
        return
    print_found(drift_tables.sentences(result), [drift_tables.drift_shown(result)], full=full)
    print_written(*writers)


def as_dictionary(result: "RobotDrift") -> dict[str, Any]:
    """A robot's drift as one JSON object, with times as text."""
    from deltaid.fleets.drift_tables import drift_table

    common = ("robot", "false_alarms", "tool_change", "tool_mass")
    value = {
        "robot": result.robot,
        "recordings": len(result.recordings),
        "first": result.recordings[0].time,
        "last": result.recordings[-1].time,
        "false_alarms": result.bound,
        "tool_changes": [
            {"day": result.date(tool.day), "mass": tool.mass, "std": tool.std}
            for tool in result.tools
        ],
        "drives": [
            {key: entry for key, entry in row.items() if key not in common}
            for row in drift_table([result]).to_dicts()
        ],
    }
    return _with_text(value)


def _with_text(value: Any) -> Any:
    """The same with times as text, at every depth."""
    match value:
        case datetime():
            return value.isoformat(timespec="seconds")
        case dict():
            return {key: _with_text(entry) for key, entry in value.items()}
        case list():
            return [_with_text(entry) for entry in value]
        case _:
            return value
