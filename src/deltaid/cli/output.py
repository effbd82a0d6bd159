"""Output of all commands: results that fit a screen, remarks, tables, JSON, files."""

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
from pathlib import Path
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

import deltaid
from deltaid.errors import DeltaidError, visible
from deltaid.files import together, write_bytes
from deltaid.progress import shown_in_terminal
from deltaid.view.page import WIDEST
from deltaid.view.page import Table as Finished

# Names of columns that wrap in a narrow terminal, and of all with text, which are left-aligned.
_WRAPPED_COLUMNS = (
    "robot", "mechanism", "base parameter", "chosen law", "why", "of", "may change unnoticed",
    "entries", "parted by any of", "model", "remark", "detected",
)  # fmt: skip
_TEXT_COLUMNS = (*_WRAPPED_COLUMNS, "unit", "from", "recording", "check")
# Number of lines of a result on a usual screen, without those that name written files.
SCREEN = 22
# Grades that begin a verdict on a model.
_GRADES = ("Good", "Fair", "Doubtful", "Poor", "Untested", "Against the truth")
# Styles of remarks by their first word, and of verdicts by their grade; an infeasible motion makes
# a result worthless.
_STYLES = {
    "error": "bold red", "warning": "yellow", "not feasible": "bold red", "note": "dim",
    "wrong": "bold red", "doubtful": "yellow", "cannot tell": "cyan", "good": "green",
}  # fmt: skip

# Control characters that JSON leaves unescaped.
_CONTROL = re.compile("[\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class LiteralConsole(Console):
    """A console that prints text verbatim, whatever names and titles contain.

    Brackets are not markup, and no character controls the terminal. Styles are given as objects.
    """

    def render_str(self, text: str, **options: Any) -> Text:
        """Verbatim text of a line, a cell or a title."""
        options.update(markup=False, emoji=False)
        return super().render_str(visible(text), **options)


console = LiteralConsole(highlight=False, soft_wrap=True)
error_console = LiteralConsole(stderr=True, highlight=False, soft_wrap=True)


def remark(kind: str, *texts: object) -> None:
    """Print remarks of a kind on standard error, so that --json stays clean: one line each, folded
    at words in a terminal."""
    for text in texts:
        mark = styled(f"{kind}:", _STYLES[kind])
        error_console.print(mark, str(text), soft_wrap=not error_console.is_terminal)


@contextmanager
def used(model: "deltaid.Model", *, force: bool = False, as_prior: bool = True) -> Generator[None]:
    """Warn of a model that a command uses, if it is not good or was changed by hand.

    Args:
        force: whether a poor model may be used.
        as_prior: whether to note that a robot without a model has its prior parameters.

    Raises:
        DeltaidError: the model is poor, and `force` is not set; before it is used.
    """
    if model.identified is None:
        yield
        if as_prior:
            note_prior(model)
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
        remark("note", f"{model.source}: {verdict.sentence}")
    if CHANGED in model.identified.warnings:
        remark("warning", f"{model.source}: {CHANGED}")


def note_prior(model: "deltaid.Model") -> None:
    """Note that a robot without a model has its prior parameters."""
    remark("note", f"{model.source} is a robot: it stands for its prior parameters")


def note_planned(model: "deltaid.Model") -> None:
    """Note that a plan uses the parameters of an identified model."""
    if model.identified is not None:
        remark("note", f"{model.source} is a model: planned with its masses and friction")


def styled(text: str, style: str = "bold") -> Text:
    return Text(visible(text), style)


def print_json(value: Mapping[str, Any]) -> None:
    """One JSON object on standard output, with times as text and arrays as lists."""

    def plain(item: Any) -> Any:
        return item.isoformat(timespec="seconds") if isinstance(item, datetime) else item.tolist()

    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False, default=plain)
    print(_CONTROL.sub(lambda match: f"\\u{ord(match[0]):04x}", text))


def print_outcome(
    as_json: bool,
    value: Mapping[str, Any],
    lines: Sequence[str],
    tables: Sequence[Finished] = (),
    further: Sequence[Finished] = (),
    details: Sequence[str] = (),
    *,
    full: bool = True,
    files: Sequence[Path | None] = (),
) -> None:
    """Print a result as one JSON object, or as `print_found` does, and the written files."""
    if as_json:
        print_json(value)
    else:
        print_found(lines, tables, further, details, full=full)
        print_written(*files)


def print_found(
    lines: Sequence[str],
    tables: Sequence[Finished] = (),
    further: Sequence[Finished] = (),
    details: Sequence[str] = (),
    *,
    full: bool,
) -> None:
    """Print a result: sentences first, then as many tables as fit a screen, or all of them.

    Args:
        lines: the verdict in sentences.
        tables: the most important first; one that does not fit is cut.
        further, details: additional tables and sentences of the full output.
        full: whether to print the full output.
    """
    used = 0
    for line in _folded(*lines):
        console.print(line)
        used += max(1, math.ceil(cell_len(str(line)) / console.width))
    hidden = [] if full else [_name(finished) for finished in further]
    for finished in (*tables, *further) if full else tables:
        rows, height = _fitting(finished, None if full else SCREEN - used - 2 - bool(hidden))
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
    for line in _folded(f"→ {text}"):
        console.print(styled(str(line), "dim"))


def _name(finished: Finished) -> str:
    return re.split("[:;,]", finished.title or finished.columns[0])[0]


def _fitting(finished: Finished, lines: int | None) -> tuple[int, int]:
    """Number of rows of a table that fit a number of lines (fewer than two count as none), and
    their height."""
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

    The grade at the start of a verdict is bold.
    """
    width = min(console.width, WIDEST) if console.is_terminal else math.inf
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
    """A plain table; the first column and text are left-aligned, numbers right-aligned."""
    columns, rows = finished.columns, [[visible(cell) for cell in row] for row in finished.rows]
    result = Table(
        title=finished.title, title_justify="left", title_style="bold", box=None, pad_edge=False
    )
    widths = [max(map(cell_len, cells)) for cells in zip(columns, *rows, strict=True)]
    needed = sum(widths) + 2 * (len(widths) - 1)
    if needed > console.width and not set(columns) & set(_WRAPPED_COLUMNS):
        result.width = needed  # the terminal breaks the line, which keeps numbers whole
    for i, column in enumerate(columns):
        wrapped = column in _WRAPPED_COLUMNS
        words = [word for row in rows for word in row[i].split()] if wrapped else []
        whole = i == 0 and rows and not wrapped
        result.add_column(
            column,
            justify="left" if i == 0 or column in _TEXT_COLUMNS else "right",
            header_style="dim",
            no_wrap=not wrapped,
            max_width=WIDEST if wrapped else None,
            min_width=widths[i] if whole else max(map(cell_len, words), default=None),
        )
    for row in rows:
        result.add_row(*(styled(cell, _STYLES.get(cell, "")) for cell in row))
    return result


@contextmanager
def progress(silent: bool) -> Generator[Callable[[str], None], None, None]:
    """A progress bar on standard error with the current stage; none if silent or not a terminal.

    Stages such as 'gathered 3 of 8 recordings' move the bar; without numbers it only shows
    activity. With the variable DELTAID_PROGRESS=lines each stage is a printed line, for programs.
    """
    if os.environ.get("DELTAID_PROGRESS") == "lines":
        yield lambda text: error_console.print(f"progress: {text}")
        return
    if silent or not error_console.is_terminal:
        yield lambda _: None
        return
    yield from shown_in_terminal(error_console)
    sys.stderr.flush()


def write_files(*files: tuple[Path | None, str | Callable[[Path], object]]) -> None:
    """Write all requested files or none; each from a text or by a function."""
    with together():
        for path, content in files:
            if path is None:
                continue
            if isinstance(content, str):
                write_bytes(path, content.encode())
            else:
                content(path)


def print_written(*paths: Path | None) -> None:
    """Print names of written files; None for one that was not requested."""
    for path in paths:
        if path is not None:
            console.print(f"wrote {path}")
