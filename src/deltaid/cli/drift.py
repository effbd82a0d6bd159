"""`deltaid drift`: friction over weeks and months, from factor files."""

import os
import re
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import deltaid
from deltaid.cli.gather import in_folders
from deltaid.cli.options import AsJson, Full, UsePoor, output_file
from deltaid.cli.output import judged, print_found, print_json, progress
from deltaid.cli.output_files import print_written, require_outputs
from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.fleets.drift_findings import DriftSettings
    from deltaid.fleets.factor_file import FactorFile

_LIMIT = re.compile(r"(\d+(?:\.\d+)?)\s*(N\s*·?\s*m|N)?")

Limit = Annotated[
    str | None,
    typer.Option(
        help="Friction that is too much: times what it was, such as 1.5, or 12Nm, or 40N.",
        metavar="LIMIT",
    ),
]
FalseAlarms = Annotated[
    float, typer.Option(help="False alarms of drift that a robot may have in a year, at most.")
]
Since = Annotated[
    str | None,
    typer.Option(
        help="Exclude from drift what was recorded before this day, such as that of a repair.",
        metavar="DATE",
    ),
]


def drift_settings(limit: str | None, false_alarms: float, since: str | None) -> "DriftSettings":
    """Settings of the search for drift, from options of a command.

    Raises:
        DeltaidError: a limit is no number, or cannot be; there is no such day.
    """
    from deltaid.fleets.drift_findings import DriftSettings

    parts = None if limit is None else _LIMIT.fullmatch(limit.strip())
    if limit is not None and parts is None:
        raise DeltaidError(
            f"must be a number such as 1.5, or a torque or force, 12Nm or 40N, not {limit!r}",
            where="--limit",
        )
    number, unit = parts.groups() if parts else (None, None)
    try:
        day = None if since is None else datetime.fromisoformat(since)
    except ValueError:
        day = None
    if since is not None and (day is None or day.tzinfo is not None):
        raise DeltaidError(
            f"must be a date, not {since}", where="--since", cure="write it as 2026-01-31"
        )
    try:
        return DriftSettings(
            limit=None if number is None else float(number),
            limit_is="torque" if unit else "share",
            false_alarms=false_alarms,
            since=day,
        )
    except DeltaidError as error:
        option = f"--{error.where.replace('_', '-')}"
        raise DeltaidError(error.what, where=option, cure=error.cure) from None


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
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import identify_gathered
    from deltaid.fleets.robot_drift import recorded, robot_drift

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
    model = deltaid.load(robot)
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
        common = ("robot", "false_alarms", "tool_change", "tool_mass")
        print_json(
            {
                "robot": result.robot,
                "recordings": len(result.recordings),
                "first": result.recordings[0].time,
                "last": result.recordings[-1].time,
                "false_alarms": result.bound,
                "tool_changes": [
                    {"day": result.date(tool.day), "mass": tool.mass, "std": tool.std}
                    for tool in result.tools
                ],
                "drives": drift_tables.drift_table([result]).drop(common).to_dicts(),
            }
        )
    else:
        print_found(drift_tables.sentences(result), [drift_tables.drift_shown(result)], full=full)
        print_written(*writers)
