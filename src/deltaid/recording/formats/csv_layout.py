"""How a CSV file is laid out: where its names stand, what separates them, where the data begins."""

import csv
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.formats.csv_end import NO_LINE_BREAK, find_end, is_marked_row, is_number
from deltaid.recording.formats.csv_head import (
    COMMENT,
    SEPARATORS,
    HeadLines,
    as_text,
    cells_of,
    decoded,
    is_comment,
    names_in,
    separator_of,
)
from deltaid.recording.formats.stream import content
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.units import is_unit

_SEARCHED_LINES = 200
_DEFAULT_NAME = re.compile(r"t|time|(?:q|qd|qdd|tau)(?:\d+|\[\d+\])")


@dataclass(frozen=True)
class CsvLayout:
    """How a CSV file is written.

    Attributes:
        path: the file.
        header: names of the columns.
        separator: between its fields.
        header_row, first_row: lines of the names and of the first data, from 1.
        data_start, data_size: where the data starts, and how much there is [bytes].
        ends_open: whether the file ends without a line break.
        units: of columns, as stated under the header.
        warnings: what was seen of the layout.
        comments: for each comment line that was met among the data, the row after it, comments not
            counted.
        marked: comment lines that hold a number for every column but the first.
    """

    path: Path
    header: tuple[str, ...]
    separator: str
    header_row: int
    first_row: int
    data_start: int
    data_size: int
    ends_open: bool
    units: dict[str, str]
    warnings: tuple[Doubt, ...]
    marked: list[int]
    comments: list[int] = field(default_factory=list[int])

    def line(self, row: int) -> int:
        """A row as a user counts it: with the comment lines among the data."""
        return row + bisect_right(self.comments, row)

    def row_place(self, row: int) -> str:
        """One row, for messages."""
        return f"{self.path}, row {self.line(row)}"

    @property
    def doubts(self) -> list[Doubt]:
        """What was seen while all rows were read."""
        found: list[Doubt] = []
        if self.marked:
            found.append(
                Doubt(
                    f"lines that begin with a comment mark are left out, but {len(self.marked)} of "
                    "them hold a number for every other column, the first in row "
                    f"{self.marked[0]}",
                    cause="rows were commented out by hand",
                    cure="if they are data, remove the mark",
                )
            )
        if self.ends_open:
            found.append(NO_LINE_BREAK)
        return found

    def cure(self, written: str) -> str:
        """What to do about a field that is no number; empty if its marks do not say."""
        if "," in written and self.separator == ",":
            return "decimal commas need semicolons or tabs between the columns"
        if "," in written or "." in written:
            return "write all numbers alike, with decimal point or comma, and no thousands sign"
        return ""


@dataclass(frozen=True)
class _Header:
    """The line of column names, or without one the first line of numbers."""

    row: int
    separator: str
    names: tuple[str, ...]
    holds_numbers: bool = False


def open_csv(path: Path, mapping: ColumnMapping) -> CsvLayout:
    """The layout of a CSV file.

    Its names stand in `mapping.header_row` if that is given, else in the first of 200 lines that
    holds those of time and positions.

    Raises:
        RecordingError: it is not text, or its header is missing.
    """
    with content(path) as file:
        lines = HeadLines(file, path)
        header, warnings = _header(lines, path, mapping)
        first_row, units = mapping.data_row, dict[str, str]()
        if first_row is None:
            first_row = _after_comments(lines, header.row + (not header.holds_numbers))
            if not header.holds_numbers and (units := _units(lines[first_row], header, mapping)):
                warnings.append(
                    Doubt(
                        f"row {first_row} is taken for units ({', '.join(units.values())})",
                        cause="the logger writes them below the names",
                        cure="check them; units in a mapping go first",
                    )
                )
                first_row = _after_comments(lines, first_row + 1)
        before = lines[first_row - 1] if first_row > 1 else b""
        data_start = lines.size(first_row - 1)
        above = range(header.row + 1, first_row) if mapping.data_row is None else ()
        marked = [
            row
            for row in above
            if is_comment(lines[row])
            and is_marked_row(lines[row], header.separator, len(header.names))
        ]
    with content(path) as file:
        end = find_end(file, data_start, header.separator)
    if end.tag:
        warnings.append(
            Doubt(
                f"ends with text after its data ('{end.tag}'), which is left out",
                cause="the logger marks the end of its file",
                cure="nothing is to be done; if data follows it, make a file of each part",
            )
        )
    return CsvLayout(
        path,
        header.names,
        header.separator,
        header.row,
        first_row,
        data_start,
        end.size,
        ends_open=not (end.last_byte or before).endswith(b"\n"),
        units=units,
        warnings=tuple(warnings),
        marked=marked,
    )


def _header(lines: HeadLines, path: Path, mapping: ColumnMapping) -> tuple[_Header, list[Doubt]]:
    given = bool({"header_row", "data_row"} & mapping.model_fields_set)
    needed = mapping.needed
    numbered = all(name.isdecimal() for names in needed for name in names)
    row = mapping.header_row if given else None
    if row is None and not numbered:
        row = _row_of_names(lines, needed)
    if row is None:
        row = _after_comments(lines, 1)
    text = decoded(lines[row], f"{path}, row {row}")
    bare = COMMENT.sub("", text, count=1)
    # A mark that has a field of its own is the name of a column.
    if _holds(bare, needed) and not bare.lstrip(" ").startswith(SEPARATORS):
        text = bare
    separator = separator_of(text)
    names = names_in(text, separator, f"{path}, row {row}")
    holds_numbers = all(is_number(name) for name in names)
    if holds_numbers and not numbered:
        raise RecordingError(
            "has no header: its first row holds numbers",
            where=f"{path}, row {row}",
            cure="put a row of column names first, such as t,q1,q2,q3,tau1,tau2,tau3, or number "
            "the columns in a mapping (column: 1 is the first)",
        )
    if numbered and (holds_numbers or not _are_among(needed, names)):
        names = tuple(str(i + 1) for i in range(len(names)))
    skipped = [i for i in range(1, row) if lines[i].strip() and not is_comment(lines[i])]
    warnings: list[Doubt] = []
    if skipped and not given:
        warnings.append(
            Doubt(
                f"row {row} is taken for the column names; what stands above it is left out",
                cause="the logger writes a preamble",
                cure="if the names stand elsewhere, say so with `header_row:` in a mapping",
            )
        )
    return _Header(row, separator, names, holds_numbers), warnings


def _row_of_names(lines: HeadLines, needed: tuple[tuple[str, ...], ...]) -> int | None:
    """The first line that holds the names needed, be it as a comment."""
    for row in range(1, _SEARCHED_LINES + 1):
        if not lines[row]:
            return None
        text = as_text(lines[row])
        if _holds(text, needed) or _holds(COMMENT.sub("", text, count=1), needed):
            return row
    return None


def _holds(text: str, needed: tuple[tuple[str, ...], ...]) -> bool:
    try:
        return _are_among(needed, cells_of(text, separator_of(text)))
    except csv.Error:
        return False


def _are_among(needed: tuple[tuple[str, ...], ...], names: Sequence[str]) -> bool:
    return all(any(name in names for name in one_of) for one_of in needed)


def _after_comments(lines: HeadLines, row: int) -> int:
    """The first line from a row on that is no comment."""
    start = row
    while is_comment(lines[row]):
        row += 1
        if row - start > _SEARCHED_LINES:
            return start
    return row


def _units(line: bytes, header: _Header, mapping: ColumnMapping) -> dict[str, str]:
    """The unit of each column that may be used, if the line under the names is a row of units."""
    try:
        cells = cells_of(as_text(line), header.separator)
    except csv.Error:
        return {}
    if len(cells) != len(header.names) or any(cell and is_number(cell) for cell in cells):
        return {}
    units = {
        name: cell.strip("[]() ")
        for name, cell in zip(header.names, cells, strict=True)
        if any(name in one_of for one_of in mapping.needed)
        or (_DEFAULT_NAME.fullmatch(name) and cell)
    }
    return units if all(is_unit(unit) for unit in units.values()) else {}
