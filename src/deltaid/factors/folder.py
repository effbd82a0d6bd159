"""A folder of factor files: one a recording, each gathered once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from deltaid.errors import DeltaidError
from deltaid.factors.file import ENDING, read_key, write
from deltaid.factors.gather import gathered
from deltaid.factors.keys import digest, safe, ways
from deltaid.identification.fit import Progress
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping, mapping_each
from deltaid.recording.opening import open_table
from deltaid.robot.description import RobotDescription

State = Literal["new", "there", "refused"]


@dataclass(frozen=True)
class Gathering:
    """What became of one recording.

    Attributes:
        log: the recording.
        path: its factor file, whether or not it could be made.
        state: 'new', 'there' where it had been made before, or 'refused'.
        error: why it was refused.
    """

    log: Path
    path: Path
    state: State
    error: DeltaidError | None = None

    @property
    def reason(self) -> str:
        """Why it was refused; empty if it was not."""
        return "" if self.error is None else str(self.error)


def gather_into(
    folder: Path,
    robot: RobotDescription,
    logs: Sequence[Path],
    *,
    columns: "Sequence[ColumnMapping | None] | ColumnMapping | None" = None,
    settings: Settings | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> Iterator[Gathering]:
    """Gather recordings into a folder, one after the other; those that are there are not read.

    A recording that cannot be used is refused with its reason and does not stop the others.

    Args:
        folder: made if there is none.
        robot, columns, settings, force, progress: as of `deltaid.identify`.
    """
    settings = settings or Settings()
    for log, mapping in zip(logs, mapping_each(columns, len(logs)), strict=True):
        path = folder / f"{safe(log.name)}{ENDING}"
        try:
            key = key_of(robot, log, mapping, settings)
            path = folder / f"{safe(log.stem)}-{key[:10]}{ENDING}"
            if read_key(path) == key:
                yield Gathering(log, path, "there")
                continue
            found = gathered(
                robot, log, columns=mapping, settings=settings, force=force, progress=progress
            )
            write(found, path, key)
        except DeltaidError as error:
            yield Gathering(log, path, "refused", error)
            continue
        yield Gathering(log, path, "new")


def key_of(
    robot: RobotDescription, log: Path, mapping: ColumnMapping | None, settings: Settings
) -> str:
    """What a factor file follows from, as a checksum: the recording's bytes, the mechanism, the
    mapping, settings of filter, masks and corrections, and the versions of deltaid and of the file.

    Raises:
        RecordingError: the recording cannot be read.
    """
    sha256 = open_table(log, mapping or ColumnMapping()).checksum([])
    return digest([sha256, version("deltaid"), ways(robot, mapping, settings)])
