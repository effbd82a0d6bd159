"""What all commands print: errors, tables, progress, JSON."""

import json
import os
import re
import sys
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from deltaid.errors import DeltaidError, visible
from deltaid.files import require_writable
from deltaid.view.numbers import number as number
from deltaid.view.numbers import percent as percent  # for the commands too
from deltaid.view.page import Table as Finished

if TYPE_CHECKING:
    from deltaid.model.model import Model

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
def used(model: "Model", *, force: bool = False) -> Generator[None]:
    """As `judged`; of a robot it says that it stands for its prior."""
    with judged(model, force=force):
        yield
    print_origin(model)


@contextmanager
def judged(model: "Model", *, force: bool = False) -> Generator[None]:
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


def print_origin(model: "Model") -> None:
    """Say on standard error that a robot stands for its prior, where a model is expected."""
    if model.identified is None:
        print_note(f"{model.source} is a robot: it stands for its prior parameters")


def print_note(text: str) -> None:
    """A remark on standard error that is no warning."""
    error_console.print(styled("note:", "dim"), text)


def print_verdict(text: str) -> None:
    """A verdict in plain words, its grade in bold."""
    grade, _, rest = text.partition(":")
    console.print(styled(f"{grade}:"), rest.strip())


def styled(text: str, style: str = "bold") -> Text:
    """Text in a style of its own, such as 'bold'."""
    return Text(visible(text), style)


def print_json(value: dict[str, Any]) -> None:
    """One JSON object on standard output."""
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    print(_CONTROL.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def print_written(*paths: Path | None) -> None:
    """Names of files that have been written; None for one that was not asked for."""
    for path in paths:
        if path is not None:
            console.print(f"wrote {path}")


def shown(finished: Finished) -> Table:
    """A finished table as the terminal prints it."""
    return table(finished.title, finished.columns, finished.rows)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A plain table; the first column and those of text are left-aligned, numbers right."""
    rows = [[visible(cell) for cell in row] for row in rows]
    result = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    widths = [max(map(cell_len, cells)) for cells in zip(columns, *rows, strict=True)]
    needed = sum(widths) + 2 * (len(widths) - 1)
    if needed > console.width and not set(columns) & set(_WRAPPED_COLUMNS):
        result.width = needed  # a line that the terminal breaks rather than numbers cut off
    for i, column in enumerate(columns):
        text = i == 0 or column in _TEXT_COLUMNS
        justify = "left" if text else "right"
        wrapped = column in _WRAPPED_COLUMNS
        words = [word for row in rows for word in row[i].split()] if wrapped else []
        whole = i == 0 and rows and not wrapped
        width = widths[i] if whole else max(map(cell_len, words), default=None)
        result.add_column(
            column,
            justify=justify,
            header_style="dim",
            no_wrap=not wrapped,
            min_width=width,
        )
    for row in rows:
        result.add_row(*row)
    return result


_COLOURS = {"wrong": "bold red", "doubtful": "yellow", "cannot tell": "cyan", "good": "green"}
# A line of text that is longer is hard to read.
WIDEST = 100


def verdicts_shown(finished: Finished) -> Table:
    """A table of verdicts: cause and next step stand below what was seen, whatever the width."""
    result = Table(box=None, pad_edge=False, show_header=False)
    result.add_column(no_wrap=True)
    result.add_column(no_wrap=True)
    result.add_column(max_width=WIDEST, overflow="fold")
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


def require_outputs(inputs: Iterable[str | Path | None], files: Mapping[str, Path | None]) -> None:
    """Refuse before any work files that could not be written, would replace an input or each other.

    Args:
        inputs: names of files, of robots in the catalogue, or None for what is not given.
        files: by option, such as '--output'; that of '--report' must be a page.
    """
    given = [Path(name) for name in inputs if name is not None]
    taken: dict[Path, str] = {}
    for option, path in files.items():
        if path is None:
            continue
        if option == "--report" and path.suffix.lower() != ".html":
            raise DeltaidError("must end in .html", where=f"--report {path}")
        require_writable(path, given)
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise DeltaidError(
                f"is the file of {other} as well; give another name", where=f"{option} {path}"
            )
