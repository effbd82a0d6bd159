"""Gather recordings of one robot into a folder, for `deltaid gather`."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from deltaid.errors import DeltaidError
from deltaid.fleets.factor_file import ENDING, digest, gathering_digest, safe, write
from deltaid.fleets.gather import gathered
from deltaid.fleets.place import Place
from deltaid.identification.fit import Progress
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping, ColumnMappings, mapping_each
from deltaid.recording.opening import open_table
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True)
class Gathering:
    log: Path
    path: Path  # its factor file, even if refused
    state: Literal["new", "there", "refused"]  # 'there' if it existed before
    error: DeltaidError | None = None  # reason of a refusal


def gather_into(
    folder: Path,
    robot: RobotDescription,
    logs: Sequence[Path],
    *,
    columns: ColumnMappings = None,
    settings: Settings | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> Iterator[Gathering]:
    """Gather recordings into a folder, one after the other; existing files are not made again.

    A recording that cannot be used is refused with its reason and does not stop the others. The
    name of a file contains a checksum of its inputs: the recording's bytes, the mechanism, the
    mapping, settings of filter, masks and corrections, and the versions of deltaid and of the file.
    The folder is made if missing; other arguments are those of `deltaid.identify`.

    Raises:
        DeltaidError: the folder is a file.
    """
    if os.path.isfile(folder):  # unlike Path.is_file it never raises
        raise DeltaidError(
            "is a file; factor files need a folder", where=str(folder), cure="give another name"
        )
    settings = settings or Settings()
    for log, mapping in zip(logs, mapping_each(columns, len(logs)), strict=True):
        path = folder / f"{safe(log.name)}{ENDING}"
        try:
            sha256 = open_table(log, mapping or ColumnMapping()).checksum([])
            key = digest([sha256, version("deltaid"), gathering_digest(robot, mapping, settings)])
            path = folder / f"{safe(log.stem)}-{key[:10]}{ENDING}"
            is_there = Place.named(folder).factors(path.name, key) is not None
            if not is_there:
                file = gathered(
                    robot, log, columns=mapping, settings=settings, force=force, progress=progress
                )
                write(file, path, key)
        except DeltaidError as error:
            yield Gathering(log, path, "refused", error)
        else:
            yield Gathering(log, path, "there" if is_there else "new")
