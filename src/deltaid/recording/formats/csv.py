"""Opens CSV files of any layout: comments, preambles, units, decimal commas, compression.

Finds the line of names, the separator, and the first line of data.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.address import RecordedField
from deltaid.recording.column_meanings import unit_of
from deltaid.recording.formats.csv_lines import (
    COMMENT,
    SEARCHED_LINES,
    SEPARATORS,
    HeadLines,
    as_text,
    cells_of,
    decoded,
    is_comment,
    is_marked_row,
    is_number,
    names_in,
    separator_of,
)
from deltaid.recording.formats.csv_table import CsvTable
from deltaid.recording.mapped_columns import NEEDED
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import LogTable, content
from deltaid.recording.units import is_unit

_DEFAULT_NAME = re.compile(r"t|time|(?:q|qd|qdd|tau)(?:\d+|\[\d+\])")


@dataclass(frozen=True)
class _NameLine:
    row: int
    separator: str
    names: tuple[str, ...]
    holds_numbers: bool = False


def open_csv(path: Path, mapping: ColumnMapping) -> LogTable:
    """Open a CSV file of any layout.

    Its names are in `mapping.header_row` if that is given, else in the first of the searched lines
    that has the names of time and positions.

    Raises:
        RecordingError: the file is not text, or its header is missing.
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
        above = range(header.row + 1, first_row) if mapping.data_row is None else ()
        marked = [
            row
            for row in above
            if is_comment(lines[row])
            and is_marked_row(lines[row], header.separator, len(header.names))
        ]
        is_utf8 = as_text(lines[header.row]).encode() in lines[header.row]
        data = lines.data(first_row, header.separator)
    if data.tag:
        warnings.append(
            Doubt(
                f"ends with text after its data ('{data.tag}'), which is ignored",
                cause="the logger marks the end of its file",
                cure="no action is needed; if data follows it, make a file of each part",
            )
        )
    return CsvTable(
        path,
        tuple(RecordedField(name) for name in header.names),
        data,
        header.row,
        marked,
        first_row=first_row,
        units=units,
        warnings=tuple(warnings),
        cure_of_missing="separate the columns by comma, semicolon, tab or blanks"
        if len(header.names) == 1
        else ("" if is_utf8 else "save the file as UTF-8, in which its names are not; or ")
        + "rename the columns to t, q1…, tau1… (and qd1…, qdd1… if recorded), or say which is "
        "which with --columns MAPPING.yaml, and in which row (header_row) the names are",
    )


def _header(lines: HeadLines, path: Path, mapping: ColumnMapping) -> tuple[_NameLine, list[Doubt]]:
    given = "header_row" in mapping.model_fields_set
    needed = mapping.needed
    numbered = all(name.isdecimal() for names in needed for name in names)
    row = mapping.header_row if given else mapping.data_row if numbered else None
    texts = ((k, as_text(line)) for k, line in lines.first(SEARCHED_LINES))
    if row is None and not numbered:
        named = (k for k, text in texts for x in (text, _bare(text)) if _has_names(x, needed))
        row = next(named, None)
    if row is None:
        cells = ((k, cells_of(text, separator_of(text))) for k, text in texts if numbered)
        numbers = (k for k, x in cells if len(x) >= len(NEEDED) and all(map(is_number, x)))
        row = _row_above_numbers(lines) or next(numbers, None) or _after_comments(lines, 1)
    text = decoded(lines[row], f"{path}, row {row}")
    bare = _bare(text)
    # A comment mark that fills a whole field is the name of a column.
    if _has_names(bare, needed) and not bare.lstrip(" ").startswith(SEPARATORS):
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
                f"row {row} is taken for the column names; the lines above it are ignored",
                cause="the logger writes a preamble",
                cure="if the names stand elsewhere, say so with `header_row:` in a mapping",
            )
        )
    return _NameLine(row, separator, names, holds_numbers), warnings


def _bare(text: str) -> str:
    return COMMENT.sub("", text, count=1)


def _row_above_numbers(lines: HeadLines) -> int | None:
    """First line of words above a line of as many numbers, or above a row of units and such a line:
    unknown names below a preamble."""
    for row, line in lines.first(SEARCHED_LINES):
        separator = separator_of(as_text(line))
        names, *below = (cells_of(as_text(lines[row + k]), separator) for k in range(3))
        if len(names) < len(NEEDED) or any(is_number(name) for name in names):
            continue
        for cells in below:
            filled = [cell for cell in cells if cell]
            if len(cells) == len(names) and filled and all(map(is_number, filled)):
                return row
            if any(map(is_number, filled)) or len(cells) != len(names):
                break
    return None


def _has_names(text: str, needed: tuple[tuple[str, ...], ...]) -> bool:
    return _are_among(needed, cells_of(text, separator_of(text)))


def _are_among(needed: tuple[tuple[str, ...], ...], names: Sequence[str]) -> bool:
    return all(any(name in names for name in spellings) for spellings in needed)


def _after_comments(lines: HeadLines, row: int) -> int:
    """First line from `row` on that is no comment; `row` itself if all searched lines are."""
    searched = range(row, row + SEARCHED_LINES + 1)
    return next((k for k in searched if not is_comment(lines[k])), row)


def _units(line: bytes, header: _NameLine, mapping: ColumnMapping) -> dict[str, str]:
    """Units of the columns that may be used; empty if the line is no row of units."""
    cells = cells_of(as_text(line), header.separator)
    if len(cells) != len(header.names) or any(cell and is_number(cell) for cell in cells):
        return {}
    needed = [name for spellings in mapping.needed for name in spellings]
    is_foreign = not {*needed} & {*header.names}
    used = {
        name: cell.strip("[]() ")
        for name, cell in zip(header.names, cells, strict=True)
        if name in needed or (cell and (is_foreign or _DEFAULT_NAME.fullmatch(name)))
    }
    units = dict[str, str]()
    for name, cell in used.items():
        unit = unit_of(cell)
        if unit is None or (_DEFAULT_NAME.fullmatch(name) and not is_unit(cell)):
            return {}
        units[name] = cell if is_unit(cell) else unit or cell
    return units
