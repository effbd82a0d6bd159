"""Python files of the user's own: run when the user names them, and never otherwise."""

import hashlib
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltaid.errors import DescriptionError, quoted
from deltaid.robot.own import OwnMechanism, name_file

# The function that a Python file has to define.
FUNCTION = "mechanism"


@dataclass(frozen=True)
class NamedFile:
    """A Python file that the user has named, and the function that it defines."""

    path: str
    function: Callable[..., Any]


# By SHA-256.
_files: dict[str, NamedFile] = {}


def use_mechanism(path: str | Path) -> str:
    """Run a Python file that defines `mechanism(z)`, for descriptions that have one of their own.

    Returns its SHA-256, by which descriptions and models know the file.

    Raises:
        DescriptionError: the file cannot be read or run, or does not define the function.
    """
    path = Path(path)
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        found = runpy.run_path(str(path)).get(FUNCTION)
    except OSError as error:
        reason = error.strerror or error
        raise DescriptionError(
            f"cannot be read: {reason}", where=str(path), cure="check its name and permissions"
        ) from None
    except (Exception, SystemExit) as error:  # what the user's code raises is told as theirs
        raise DescriptionError(
            f"fails: {failure(error, path)}",
            where=str(path),
            cure="run it alone, as `python FILE.py`, to see the whole traceback",
        ) from None
    if not callable(found):
        raise DescriptionError(
            f"defines no function `{FUNCTION}`",
            where=str(path),
            cure=f"write `def {FUNCTION}(z):` that returns a deltaid.MechanismParts",
        )
    _files.clear()
    _files[digest] = NamedFile(str(path), found)
    name_file(digest)
    return digest


def named_path() -> Path | None:
    """The Python file that the user has named, if there is one."""
    return next((Path(file.path) for file in _files.values()), None)


def named_file(own: OwnMechanism) -> NamedFile:
    """The file of a mechanism, with its function.

    Raises:
        DescriptionError: no file has been named, or another one.
    """
    if own.sha256 is None or own.sha256 not in _files:
        raise DescriptionError(
            "the Python file of this mechanism has not been named",
            where="mechanism",
            cure="call deltaid.use_mechanism('FILE.py') before, or use deltaid --mechanism FILE.py",
        )
    return _files[own.sha256]


def failure(error: BaseException, path: str | Path = "") -> str:
    """An exception of the user's code in one line: line number, kind and message."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if not path or trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}, "
        trace = trace.tb_next
    text = quoted(str(error).strip().split("\n", 1)[0])
    return f"{line}{type(error).__name__}: {text}"
