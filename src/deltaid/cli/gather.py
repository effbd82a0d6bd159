"""`deltaid gather` and `drift`: recordings as small files, and changes over months."""

import os
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import deltaid
from deltaid.cli.options import (
    AsJson,
    ColumnFiles,
    Compliance,
    Cutoff,
    Events,
    Force,
    Full,
    KeepAll,
    Lag,
    Robot,
    UsePoor,
    output_file,
    require_outputs,
)
from deltaid.cli.output import print_outcome, progress, remark, used
from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.fleets.drift_findings import DriftSettings
    from deltaid.fleets.factor_record import FactorRecord
    from deltaid.identification.torque_error import TorqueError
    from deltaid.recording.mapping import MappingLike


def gather(
    robot: Robot,
    logs: Annotated[
        list[Path], typer.Argument(help="Recordings: CSV, Parquet, MATLAB, HDF5, bags, …")
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder to write factor files into.", metavar="FOLDER"),
    ],
    columns: ColumnFiles = None,
    cutoff: Cutoff = None,
    lag: Lag = "estimate",
    compliance: Compliance = "estimate",
    keep_all: KeepAll = False,
    events: Events = True,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Condense recordings to files below 1 MB each.

    `deltaid identify` accepts these files instead of recordings. A recording that was gathered
    before is not read again.
    """
    from deltaid.fleets.gather_folder import gather_into

    settings = deltaid.Settings(
        cutoff=cutoff, lag=lag, compliance=compliance, keep_all=keep_all, events=events
    )
    description = deltaid.load_robot(robot)
    gathered = []
    with progress(as_json) as say:
        for recording in gather_into(
            output, description, logs,
            columns=columns, settings=settings, force=force, progress=say,
        ):  # fmt: skip
            gathered.append(recording)
            if recording.error is not None:
                remark("error", recording.error)
    states = [recording.state for recording in gathered]
    counts = {state: states.count(state) for state in ("new", "there", "refused")}
    print_outcome(
        as_json,
        {
            "robot": description.name,
            **counts,
            "recordings": [
                {
                    "log": str(recording.log),
                    "file": str(recording.path),
                    "state": recording.state,
                    "reason": str(recording.error or ""),
                }
                for recording in gathered
            ],
        },
        [
            f"{counts['new']} gathered, {counts['there']} there already, "
            f"{counts['refused']} refused; in {output}"
        ],
    )
    if counts["refused"]:
        raise typer.Exit(2)


def in_folders(logs: Sequence[Path]) -> list[Path]:
    """Paths with each folder replaced by the factor files in it; a folder without any is kept."""
    from deltaid.fleets.factor_file import ENDING

    inside = (sorted(log.glob(f"*{ENDING}")) if os.path.isdir(log) else [] for log in logs)
    return [file for log, files in zip(logs, inside, strict=True) for file in files or [log]]


def are_factor_files(logs: Sequence[Path]) -> bool:
    """Whether recordings are factor files.

    Raises:
        DeltaidError: some are and some are not.
    """
    from deltaid.fleets.factor_file import ENDING

    given = [log.name.endswith(ENDING) for log in logs]
    if any(given) and not all(given):
        raise DeltaidError(
            "is a recording, and others are factor files",
            where=str(logs[given.index(False)]),
            cure="gather it as well, with `deltaid gather`",
        )
    return any(given)


def require_open(given: Mapping[str, bool], report: Path | None) -> None:
    """Raise for options that gathering has fixed already, and for a page that needs samples.

    Args:
        given: options, and whether each differs from its default.

    Raises:
        DeltaidError: one of these options, or a page, is requested.
    """
    for option, is_given in given.items():
        if is_given:
            raise DeltaidError(
                "was decided as the recordings were gathered",
                where=option,
                cure=f"give {option} to `deltaid gather`, into another folder",
            )
    if report is not None:
        raise DeltaidError(
            "needs samples, which factor files do not hold",
            where="--report",
            cure="give recordings",
        )


def compared(
    model: "deltaid.Model", log: Path, columns: "MappingLike | None", keep_all: bool
) -> "deltaid.Validation | tuple[TorqueError, FactorRecord]":
    """Comparison of a model with a recording, or with its factor file."""
    if not are_factor_files([log]):
        return deltaid.validate(model, log, columns=columns, keep_all=keep_all)
    from deltaid.fleets import factor_file, identify_gathered

    file = factor_file.read(log)
    return identify_gathered.validate_gathered(model, file), file.record


_LIMIT = re.compile(r"(\d+(?:\.\d+)?)\s*(N\s*·?\s*m|N)?")

Limit = Annotated[
    str | None,
    typer.Option(
        help="Limit of friction: a multiple of its initial value, such as 1.5, or 12Nm or 40N.",
        metavar="LIMIT",
    ),
]
FalseAlarms = Annotated[float, typer.Option(help="Accepted false drift alarms per robot and year.")]
Since = Annotated[
    str | None,
    typer.Option(
        help="Exclude recordings before this day from drift, such as the day of a repair.",
        metavar="DATE",
    ),
]


def drift_settings(limit: str | None, false_alarms: float, since: str | None) -> "DriftSettings":
    """Settings of the search for drift, from options of a command.

    Raises:
        DeltaidError: a limit is no number or out of bounds, or a date does not exist.
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
        raise DeltaidError(
            error.what, where=f"--{error.where.replace('_', '-')}", cure=error.cure
        ) from None


def drift(
    robot: Robot,
    factors: Annotated[
        list[Path], typer.Argument(help="Files of `deltaid gather`, or their folder.")
    ],
    limit: Limit = None,
    false_alarms: FalseAlarms = 0.1,
    since: Since = None,
    output: Annotated[
        Path | None,
        output_file("--output", "-o", help="Table of the results to write (.parquet or .csv)."),
    ] = None,
    friction: Annotated[
        Path | None,
        output_file(help="Table of each recording's friction to write (.parquet or .csv)."),
    ] = None,
    full: Full = False,
    as_json: AsJson = False,
    force: UsePoor = False,
) -> None:
    """Detect friction that changes over weeks and months.

    The command reports since when, how fast, and when friction reaches a limit.

    Effects of temperature and load are removed. docs/drift.md describes the alarms.
    """
    from deltaid.fleets import drift_tables, factor_file, identify_gathered, robot_drift

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
    model, files = deltaid.load(robot), []
    with used(model, force=force, as_prior=False), progress(as_json) as say:
        for k, path in enumerate(paths):
            say(f"reading {k + 1} of {len(paths)}")
            files.append(factor_file.read(path))
        say("looking for drift")
        known = model.identified or identify_gathered.identify_gathered(model.robot, files).model
        result = robot_drift.robot_drift(robot_drift.recorded(files), known, settings)
    for path, table in writers.items():
        drift_tables.save(table(result), path)
    common = ("robot", "false_alarms", "tool_change", "tool_mass")
    print_outcome(
        as_json,
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
            "drives": drift_tables.drift_table(result).drop(common).to_dicts(),
        },
        drift_tables.sentences(result),
        [drift_tables.drift_shown(result)],
        full=full,
        files=tuple(writers),
    )
