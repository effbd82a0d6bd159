"""Python files of the user's own: run when the user names them, and never otherwise."""

import hashlib
import runpy
from pathlib import Path

from deltaid.errors import DescriptionError, quoted
from deltaid.robot.own import NamedFile, OwnMechanism, name_file, named_file

# The function that a Python file has to define.
FUNCTION = "mechanism"


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
    name_file(NamedFile(str(path), digest, found))
    return digest


def named_path() -> Path | None:
    """Where the Python file is that the user has named, if there is one."""
    file = named_file()
    return Path(file.path) if file else None


def file_of(own: OwnMechanism) -> NamedFile:
    """The file of a mechanism, with its function.

    Raises:
        DescriptionError: no file has been named, or another one.
    """
    file = named_file()
    if file is None or file.sha256 != own.sha256:
        raise DescriptionError(
            "the Python file of this mechanism has not been named",
            where="mechanism",
            cure="call deltaid.use_mechanism('FILE.py') before, or use deltaid --mechanism FILE.py",
        )
    return file


def failure(error: BaseException, path: str | Path = "") -> str:
    """An exception of the user's code in one line: line number, kind and message."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if not path or trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}, "
        trace = trace.tb_next
    text = quoted(str(error).strip().split("\n", 1)[0])
    return f"{line}{type(error).__name__}: {text}"
