"""`deltaid gather`: recordings as small files that everything else can be made from; and such files
in the place of recordings."""

import os
from collections.abc import Mapping, Sequence
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
    KeepAll,
    Lag,
    Robot,
)
from deltaid.cli.output import console, print_error, print_json, progress
from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.fleets.factor_record import FactorRecord
    from deltaid.identification.torque_error import TorqueError
    from deltaid.recording.mapping import MappingLike


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
    from deltaid.robot.load import described

    settings = deltaid.Settings(
        cutoff=cutoff, lag=lag, compliance=compliance, keep_all=keep_all, events=events
    )
    description = described(robot)
    gathered = []
    with progress(as_json) as say:
        for recording in gather_into(
            output, description, logs,
            columns=columns, settings=settings, force=force, progress=say,
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


def in_folders(logs: Sequence[Path]) -> list[Path]:
    """Recordings and factor files; a folder stands for the factor files in it, if there are any."""
    from deltaid.fleets.factor_file import ENDING

    files = list[Path]()
    for log in logs:
        files += (sorted(log.glob(f"*{ENDING}")) if os.path.isdir(log) else []) or [log]
    return files


def are_factor_files(logs: Sequence[Path]) -> bool:
    """Whether what is given for recordings are factor files.

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
    """Refuse options that were decided as recordings were gathered, and a page with samples.

    Args:
        given: options, and whether each is another one than by default.

    Raises:
        DeltaidError: one is given.
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
    """A model compared with a recording, or with what a factor file keeps of one."""
    if not are_factor_files([log]):
        return deltaid.validate(model, log, columns=columns, keep_all=keep_all)
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import validate_gathered

    file = read(log)
    return validate_gathered(model, file), file.record
