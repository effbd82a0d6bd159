"""`deltaid identify` with factor files in the place of recordings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.checks.identified import Judged
    from deltaid.fleets.factor_record import FactorRecord
    from deltaid.identification.torque_error import TorqueError
    from deltaid.model.model import Model
    from deltaid.model.record import Settings


def in_folders(logs: Sequence[Path]) -> list[Path]:
    """Recordings and factor files; a folder stands for the factor files in it, if there are any."""
    from deltaid.fleets.factor_file import ENDING

    found = list[Path]()
    for one in logs:
        found += (sorted(one.glob(f"*{ENDING}")) if one.is_dir() else []) or [one]
    return found


def are_factor_files(logs: Sequence[Path]) -> bool:
    """Whether what is given for recordings are factor files.

    Raises:
        DeltaidError: some are and some are not.
    """
    from deltaid.fleets.factor_file import is_factor_file

    given = [is_factor_file(one) for one in logs]
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


def identified(robot: str, logs: Sequence[Path], settings: "Settings") -> "Judged":
    """The identification from factor files."""
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import identify_gathered

    return identify_gathered(robot, [read(one) for one in logs], settings)


def validated(model: "Model", path: Path) -> "tuple[TorqueError, FactorRecord]":
    """A model compared with a recording by its factors, and what is known of the recording."""
    from deltaid.fleets.factor_file import read
    from deltaid.fleets.identify_gathered import validate_gathered

    file = read(path)
    return validate_gathered(model, file), file.record
