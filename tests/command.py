"""The `deltaid` command inside this process: exit code, standard output, standard error."""

import contextlib
import io
import json
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import typer.main

from deltaid.cli import output
from deltaid.cli.app import main

# Of all commands and options, once: to build it takes longer than a short command.
_parser = cache(typer.main.get_command)


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def errors(self) -> int:
        """How many messages there are; a key of a file may be called `error` too."""
        return sum(line.startswith("error:") for line in self.err.splitlines())


def run(*arguments: object, width: int = 80, terminal: bool = False) -> Outcome:
    """Run `deltaid ARGUMENTS` at that width. An unexpected exception is one here.

    Args:
        terminal: the result is printed as on a terminal, which folds lines, and not as to a file.
    """
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.ExitStack() as stack:
        for console in (output.console, output.error_console):
            stack.enter_context(patch.object(console, "_width", width))
        stack.enter_context(patch.object(typer.main, "get_command", _parser))
        stack.enter_context(patch.object(output.console, "_force_terminal", terminal or None))
        stack.enter_context(patch.dict("os.environ", {"COLUMNS": str(width)}))
        stack.enter_context(patch.object(sys, "argv", ["deltaid", *map(str, arguments)]))
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Outcome(code, out.getvalue(), err.getvalue())


def accepted(*arguments: object, width: int = 80) -> Outcome:
    """What a command left behind that ends well."""
    outcome = run(*arguments, width=width)
    assert outcome.code == 0, outcome
    return outcome


def json_of(*arguments: object) -> Any:
    """What a command that ends well prints with `--json`."""
    return json.loads(accepted(*arguments, "--json").out)


def refused(*arguments: object, folder: Path) -> str:
    """The one message of a command that exits with 2, prints nothing else and writes nothing."""
    before = sorted(folder.rglob("*"))
    outcome = run(*arguments)
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    assert outcome.errors == 1
    assert "Traceback" not in outcome.err
    assert sorted(folder.rglob("*")) == before
    return outcome.err
