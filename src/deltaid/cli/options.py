"""Options that many commands have."""

import glob
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from deltaid.errors import DeltaidError

# Of every command that reads torques.
KeepAll = Annotated[
    bool,
    typer.Option(
        "--keep-all", help="Leave nothing out: rest, brakes, stops, saturation, reversals."
    ),
]


def output_file(*names: str, help: str) -> Any:
    """An option with the name of a file to write; missing folders are made when it is written."""
    return typer.Option(*names, help=help, metavar="PATH", parser=_file, autocompletion=_complete)


def _file(text: str) -> Path:
    if text.endswith(("/", os.sep)):
        raise DeltaidError("is a folder; give the name of a file", where=text)
    return Path(text)


def _complete(incomplete: str) -> list[str]:
    """Files and folders that begin with what has been typed."""
    found = glob.glob(f"{glob.escape(incomplete)}*")
    return [path + "/" * os.path.isdir(path) for path in sorted(found)]
