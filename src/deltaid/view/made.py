"""How a page was made: the command line, the day, the version."""

import shlex
import sys
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

_COMMAND = "deltaid"


@dataclass(frozen=True)
class Made:
    """How a page was made.

    Attributes:
        command: as it was typed; of a program that uses deltaid as a library, that says so.
        on: day and time, with the offset from UTC.
        version: of deltaid.
    """

    command: str
    on: str
    version: str


def made() -> Made:
    """By this process, now."""
    typed = bool(sys.argv) and Path(sys.argv[0]).stem == _COMMAND
    command = shlex.join([_COMMAND, *sys.argv[1:]]) if typed else ""
    now = datetime.now().astimezone()
    return Made(command, now.strftime("%Y-%m-%d %H:%M %z"), version("deltaid"))
