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


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("gather")(gather)


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
    """Read recordings once and keep what they say: a file below 1 MB each.

    `deltaid identify` takes such files in the place of recordings. Gathering is repeated at no
    cost: a recording that has been gathered before is not read again.
    """
    from deltaid.cli.output import console, lag_of, print_error, print_json, progress
    from deltaid.errors import positive
    from deltaid.fleets.gather import gather_into
    from deltaid.model.record import Settings
    from deltaid.robot.load import described

    positive("--cutoff", cutoff)
    settings = Settings(
        cutoff=cutoff, lag=lag_of(lag), compliance=compliance, keep_all=keep_all, events=events
    )
    description = described(robot)
    done = []
    with progress(as_json) as say:
        for one in gather_into(
            output, description, logs,
            columns=mappings(columns), settings=settings, force=force, progress=say,
        ):  # fmt: skip
            done.append(one)
            if one.error is not None:
                print_error(one.error)
    counts = {
        state: sum(one.state == state for one in done) for state in ("new", "there", "refused")
    }
    if as_json:
        print_json(
            {
                "robot": description.name,
                **counts,
                "recordings": [
                    {"log": str(one.log), "file": str(one.path), "state": one.state,
                     "reason": one.reason}
                    for one in done
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
