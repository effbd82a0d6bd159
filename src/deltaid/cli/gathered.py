"""`deltaid identify` with factor files in the place of recordings."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.fleets.factor_record import FactorRecord
    from deltaid.identification.prediction import Validation
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.model import Model
    from deltaid.recording.mapping import MappingLike


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
    from deltaid.fleets.factor_file import is_factor_file

    given = [is_factor_file(log) for log in logs]
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
    model: "Model", log: Path, columns: "MappingLike | None", keep_all: bool
) -> "Validation | tuple[TorqueError, FactorRecord]":
    """A model compared with a recording, or with what a factor file keeps of one."""
    if are_factor_files([log]):
        from deltaid.fleets.factor_file import read
        from deltaid.fleets.identify_gathered import validate_gathered

        file = read(log)
        return validate_gathered(model, file), file.record
    from deltaid.identification.prediction import validate

    return validate(model, log, columns=columns, keep_all=keep_all)
