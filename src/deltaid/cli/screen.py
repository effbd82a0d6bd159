"""Results as they are printed: sentences first, then tables as far as they fit a screen."""

import math
import re
import textwrap
from collections.abc import Sequence

from rich.cells import cell_len
from rich.text import Text

from deltaid.cli.output import WIDEST, console, styled, table
from deltaid.errors import visible
from deltaid.view.page import Table as Finished

# Lines of a result on a screen of usual height, with those that name the files written below.
_SCREEN = 22
# Of a verdict on a model, as words begin it.
_GRADES = ("Good", "Fair", "Poor", "Untested", "Against the truth")


def print_found(
    lines: Sequence[str],
    tables: Sequence[Finished] = (),
    further: Sequence[Finished] = (),
    details: Sequence[str] = (),
    *,
    full: bool,
) -> None:
    """A result: sentences first, then tables as far as they fit a screen; or all of it.

    Args:
        lines: the verdict, in plain words, at first.
        tables: in the order of their worth; one that does not fit is cut.
        further, details: tables and sentences for those who ask for all.
        full: whether all is asked for.
    """
    used = 0
    for text in lines:
        for line in _folded(text):
            console.print(line)
            used += max(1, math.ceil(cell_len(str(line)) / console.width))
    hidden = [] if full else [_name(finished) for finished in further]
    for finished in (*tables, *further) if full else tables:
        left = None if full else _SCREEN - used - 2 - bool(hidden)
        rows, height = _fitting(finished, left)
        if rows:
            console.print()
            console.print(table(finished.title, finished.columns, finished.rows[:rows]))
            used += height + 1
        if rows < len(finished.rows):
            more = f"{len(finished.rows) - rows} more rows of " if rows else ""
            hidden.append(f"{more}{_name(finished)}")
    if full and details:
        console.print()
        for text in details:
            for line in _folded(text):
                console.print(line)
    if details and not full:
        hidden.append("details of the computation")
    if hidden:
        listed = ", ".join(dict.fromkeys(hidden))
        print_next(f"--full prints also: {listed}")


def print_next(text: str) -> None:
    """What the user may do next."""
    for line in _folded(f"→ {text}"):
        console.print(styled(str(line), "dim"))


def _name(finished: Finished) -> str:
    """What a table is called: its title, or what its rows are."""
    return re.split("[:;,]", finished.title or finished.columns[0])[0]


def _fitting(finished: Finished, lines: int | None) -> tuple[int, int]:
    """How many rows of a table fit so many lines, fewer than two being none, and their height."""
    rows = len(finished.rows)
    while True:
        cut = table(finished.title, finished.columns, finished.rows[:rows])
        widths = [sum(part.cell_length for part in line) for line in console.render_lines(cut)]
        height = sum(max(1, math.ceil(width / console.width)) for width in widths)
        if lines is None or height <= lines:
            return rows, height
        rows -= max(1, min(rows, height - lines) // 2)
        if rows < min(2, len(finished.rows)):
            return 0, 0


def _folded(text: str) -> list[str | Text]:
    """A sentence in lines of a terminal's width; in a file or pipe it stays one line.

    What stands before the first colon of a verdict is in bold.
    """
    if not text:
        return [""]
    width = min(console.width, WIDEST) if console.is_terminal else math.inf
    lines: list[str | Text] = (
        list(textwrap.wrap(visible(text), int(width), subsequent_indent="  "))
        if cell_len(text) > width
        else [text]
    )
    grade, colon, rest = str(lines[0]).partition(": ")
    if colon and grade in _GRADES:
        lines[0] = Text.assemble((f"{grade}:", "bold"), " ", visible(rest))
    return lines
