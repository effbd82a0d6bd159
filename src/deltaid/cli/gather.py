"""`deltaid gather`: recordings as small files that everything else can be made from."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.cli.options import (
    AsJson,
    ColumnFiles,
    Compliance,
    Cutoff,
    Events,
    Force,
    KeepAll,
    Lag,
    Robot,
    mappings,
)
from deltaid.cli.output import console, print_error, print_json, progress


def gather(
    robot: Robot,
    logs: Annotated[
        list[Path], typer.Argument(help="Recordings: CSV, Parquet, MATLAB, HDF5, bags, …")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder of factor files.", metavar="FOLDER")
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

    `deltaid identify` takes such files in the place of recordings. Gathering is repeated at no
    cost: a recording that has been gathered before is not read again.
    """
    from deltaid.fleets.gather import gather_into
    from deltaid.model.record import Settings
    from deltaid.robot.load import described

    settings = Settings(
        cutoff=cutoff, lag=lag, compliance=compliance, keep_all=keep_all, events=events
    )
    description = described(robot)
    gathered = []
    with progress(as_json) as say:
        for recording in gather_into(
            output, description, logs,
            columns=mappings(columns), settings=settings, force=force, progress=say,
        ):  # fmt: skip
            gathered.append(recording)
            if recording.error is not None:
                print_error(recording.error)
    states = [recording.state for recording in gathered]
    counts = {state: states.count(state) for state in ("new", "there", "refused")}
    if as_json:
        print_json(
            {
                "robot": description.name,
                **counts,
                "recordings": [
                    {"log": str(recording.log), "file": str(recording.path),
                     "state": recording.state, "reason": recording.reason}
                    for recording in gathered
                ],
            }
        )  # fmt: skip
    else:
        console.print(
            f"{counts['new']} gathered, {counts['there']} there already, "
            f"{counts['refused']} refused; in {output}"
        )
    if counts["refused"]:
        raise typer.Exit(2)
