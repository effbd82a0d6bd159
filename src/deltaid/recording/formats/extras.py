"""Libraries that only some kinds of files need."""

from importlib import import_module
from pathlib import Path
from typing import Any

from deltaid.errors import RecordingError


def library(name: str, kind: str, path: Path) -> Any:
    """A module that reads a kind of file.

    Raises:
        RecordingError: it is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError:
        package = name.partition(".")[0]
        raise RecordingError(
            f"is {kind}, and the library {package} that reads it is not installed",
            where=str(path),
            cure=f"pip install {package}",
        ) from None
