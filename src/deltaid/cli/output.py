"""What all commands print: results as they fit a screen, errors, tables, progress, JSON."""

import json
import math
import os
import re
import sys
import textwrap
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

import deltaid
from deltaid.errors import DeltaidError, visible
from deltaid.view.page import Table as Finished

# Columns whose cells are words.
_TEXT_COLUMNS = (
    "unit", "from", "robot", "mechanism", "base parameter", "chosen law", "model", "remark", "of",
    "recording", "why", "may change unnoticed", "entries", "parted by any of",
)  # fmt: skip
# Columns that may take several lines where the terminal is narrow.
_WRAPPED_COLUMNS = (
    "robot", "mechanism", "base parameter", "chosen law", "why", "of", "may change unnoticed",
    "entries", "parted by any of",
)  # fmt: skip
# Columns of a bar of progress.
_BAR = 16
# Lines of a result on a screen of usual height, with those that name the files written below.
_SCREEN = 22
# A line of text that is longer is hard to read.
_WIDEST = 100
# Of a verdict on a model, as words begin it.
_GRADES = ("Good", "Fair", "Poor", "Untested", "Against the truth")
_COLOURS = {"wrong": "bold red", "doubtful": "yellow", "cannot tell": "cyan", "good": "green"}

# Of JSON, besides those that it escapes anyway.
_CONTROL = re.compile("[\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class LiteralConsole(Console):
    """A console that prints text as it stands, whatever names and titles of files hold.

    Brackets are no markup, and no character commands the terminal. Styles are given as objects.
    """

    def render_str(self, text: str, **options: Any) -> Text:
        """Text as it is shown wherever it stands: in a line, a cell, a title."""
        options.update(markup=False, emoji=False)
        return super().render_str(visible(text), **options)


console = LiteralConsole(highlight=False, soft_wrap=True)
error_console = LiteralConsole(stderr=True, highlight=False, soft_wrap=True)


def print_error(error: DeltaidError) -> None:
    """One clear message on standard error."""
    error_console.print(styled("error:", "bold red"), str(error))


def print_warnings(warnings: Sequence[str]) -> None:
    """Warnings on standard error, so that --json stays clean."""
    for text in warnings:
        error_console.print(styled("warning:", "yellow"), text)


def print_problems(problems: Sequence[str]) -> None:
    """What makes a result worthless, in red on standard error; the program did run."""
    for text in problems:
        error_console.print(styled("not feasible:", "bold red"), text)


@contextmanager
def used(model: "deltaid.Model", *, force: bool = False) -> Generator[None]:
    """As `judged`; of a robot it says that it stands for its prior."""
    with judged(model, force=force):
        yield
    print_origin(model)


@contextmanager
def judged(model: "deltaid.Model", *, force: bool = False) -> Generator[None]:
    """Say on standard error what a model is worth that a command has used, where it is not good,
    and whether its file was changed by hand.

    Raises:
        DeltaidError: it is poor, and `force` is not set; before it is used.
    """
    if model.identified is None:
        yield
        return
    from deltaid.model.record import CHANGED
    from deltaid.view.page import Trust
    from deltaid.view.summary import summary

    verdict = summary(model)
    if verdict.grade is Trust.POOR and not force:
        raise DeltaidError(
            verdict.sentence.rstrip("."),
            where=model.source,
            cure="identify it from better recordings, or go on with --force",
        )
    yield
    if verdict.grade is not Trust.GOOD:
        print_note(f"{model.source}: {verdict.sentence}")
    if CHANGED in model.identified.warnings:
        print_warnings([f"{model.source}: {CHANGED}"])


def print_origin(model: "deltaid.Model") -> None:
    """Say on standard error that a robot stands for its prior, where a model is expected."""
    if model.identified is None:
        print_note(f"{model.source} is a robot: it stands for its prior parameters")


def print_note(text: str) -> None:
    """A remark on standard error that is no warning."""
    error_console.print(styled("note:", "dim"), text)


def styled(text: str, style: str = "bold") -> Text:
    """Text in a style of its own, such as 'bold'."""
    return Text(visible(text), style)


def print_json(value: Mapping[str, Any]) -> None:
    """One JSON object on standard output, with times as text."""
    of_time = partial(datetime.isoformat, timespec="seconds")
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False, default=of_time)
    print(_CONTROL.sub(lambda match: f"\\u{ord(match[0]):04x}", text))


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
    for line in _folded(*lines):
        console.print(line)
        used += max(1, math.ceil(cell_len(str(line)) / console.width))
    hidden = [] if full else [_name(finished) for finished in further]
    for finished in (*tables, *further) if full else tables:
        left = None if full else _SCREEN - used - 2 - bool(hidden)
        rows, height = _fitting(finished, left)
        if rows:
            console.print()
            console.print(table(replace(finished, rows=finished.rows[:rows])))
            used += height + 1
        if rows < len(finished.rows):
            more = f"{len(finished.rows) - rows} more rows of " if rows else ""
            hidden.append(f"{more}{_name(finished)}")
    if full and details:
        console.print()
        for line in _folded(*details):
            console.print(line)
    elif details:
        hidden.append("details of the computation")
    if hidden:
        print_next(f"--full prints also: {', '.join(dict.fromkeys(hidden))}")


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
        cut = console.render_lines(table(replace(finished, rows=finished.rows[:rows])))
        widths = [sum(part.cell_length for part in line) for line in cut]
        height = sum(max(1, math.ceil(width / console.width)) for width in widths)
        if lines is None or height <= lines:
            return rows, height
        rows -= max(1, min(rows, height - lines) // 2)
        if rows < min(2, len(finished.rows)):
            return 0, 0


def _folded(*sentences: str) -> list[str | Text]:
    """Sentences in lines of a terminal's width; in a file or pipe each stays one line.

    What stands before the first colon of a verdict is in bold.
    """
    width = min(console.width, _WIDEST) if console.is_terminal else math.inf
    lines: list[str | Text] = []
    for text in sentences:
        first, *others = (
            textwrap.wrap(visible(text), int(width), subsequent_indent="  ")
            if cell_len(text) > width
            else [text]
        )
        grade, colon, rest = first.partition(": ")
        if colon and grade in _GRADES:
            first = Text.assemble((f"{grade}:", "bold"), " ", visible(rest))
        lines += [first, *others]
    return lines


def table(finished: Finished) -> Table:
    """A plain table; the first column and those of text are left-aligned, numbers right."""
    columns, rows = finished.columns, [[visible(cell) for cell in row] for row in finished.rows]
    result = Table(
        title=finished.title, title_justify="left", title_style="bold", box=None, pad_edge=False
    )
    widths = [max(map(cell_len, cells)) for cells in zip(columns, *rows, strict=True)]
    needed = sum(widths) + 2 * (len(widths) - 1)
    if needed > console.width and not set(columns) & set(_WRAPPED_COLUMNS):
        result.width = needed  # a line that the terminal breaks rather than numbers cut off
    for i, column in enumerate(columns):
        wrapped = column in _WRAPPED_COLUMNS
        words = [word for row in rows for word in row[i].split()] if wrapped else []
        whole = i == 0 and rows and not wrapped
        result.add_column(
            column,
            justify="left" if i == 0 or column in _TEXT_COLUMNS else "right",
            header_style="dim",
            no_wrap=not wrapped,
            min_width=widths[i] if whole else max(map(cell_len, words), default=None),
        )
    for row in rows:
        result.add_row(*row)
    return result


def verdicts_shown(finished: Finished) -> Table:
    """A table of verdicts: cause and next step stand below what was seen, whatever the width."""
    result = Table(box=None, pad_edge=False, show_header=False)
    result.add_column(no_wrap=True)
    result.add_column(no_wrap=True)
    result.add_column(max_width=_WIDEST, overflow="fold")
    for grade, key, about, seen, cause, cure in finished.rows:
        lines = [seen if about in seen else f"{about}: {seen}"]
        lines += [f"likely: {cause}"] * bool(cause) + [f"→ {cure}"] * bool(cure)
        result.add_row(styled(grade, _COLOURS[grade]), visible(key), visible("\n".join(lines)))
    return result


@contextmanager
def progress(silent: bool) -> Generator[Callable[[str], None], None, None]:
    """A bar on standard error beside what is being done; nothing when silent or not a terminal.

    It follows words such as 'gathered 3 of 8 recordings'; without numbers it says that work goes
    on. For a program that watches, the variable DELTAID_PROGRESS=lines asks for a line each.
    """
    if os.environ.get("DELTAID_PROGRESS") == "lines":
        yield lambda text: error_console.print(f"progress: {text}")
        return
    if silent or not error_console.is_terminal:
        yield lambda _: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as Left

    from deltaid.progress import share_of

    columns = (BarColumn(_BAR), TimeElapsedColumn(), TextColumn("left"), Left(),
               TextColumn("{task.description}", markup=False))  # fmt: skip
    with Progress(*columns, console=error_console, transient=True) as bars:
        task, stage = bars.add_task("starting", total=None), ""

        def say(text: str, /) -> None:
            nonlocal task, stage
            word, share = text.partition(" ")[0], share_of(text)
            if word != stage:  # time left is guessed from this stage alone
                bars.remove_task(task)
                task, stage = bars.add_task(text, total=None if share is None else 1.0), word
            bars.update(task, description=visible(text), completed=share or 0.0)

        yield say
    sys.stderr.flush()
