"""Reads CSV in blocks of lines, with the line of each fault.

Blocks are whole lines, so fields are counted before polars parses them, and rows keep their line
numbers. Fields are read as text, so messages can name the place of a bad number.
"""

import io
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.formats.csv_lines import (
    NO_LINE_BREAK,
    Decimals,
    TextData,
    is_marked_row,
    is_number,
    line_ends,
    per_line,
)
from deltaid.recording.source import POLARS_ERRORS, LogTable, Rows

_FORTRAN = re.compile(r"[+-]?[\d.]+[dD][+-]?\d+")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*")
# What is wrong with a text that is no number, and its cure, in this order.
_CURES = (
    (_THOUSANDS, "write numbers without a thousands sign"),
    (
        re.compile(r"[\d.,eE+-]+"),
        "write all numbers in one way, with point or comma, and no thousands sign",
    ),
    (
        re.compile(r"(?s)\d+[:/.-]\d+[:/.-]\d.*"),
        "write times in seconds, or as 2026-01-31T14:30:00.000, with or without the date",
    ),
    (_FORTRAN, "write exponents with E, as in 1.5E+00"),
    (re.compile(r"(?s).*−.*"), "write the minus sign as on the keyboard (-)"),
    (re.compile(r"[+-]?0[xX][\da-fA-F]+"), "write numbers in decimal digits, not in hexadecimal"),
    (
        re.compile(r"[+-]?[\d.]+([eE][+-]?\d+)? *([^\W\d_]|[°%])[\w/²·°% ]*"),
        "write the number alone, and its unit in a mapping of columns (unit:, with --columns)",
    ),
)


@dataclass(frozen=True)
class CsvTable(LogTable):
    """An open CSV file, with one block in memory at a time; rows are lines of the file.

    Attributes:
        data: lines of data below the names.
        header_row: line of the names, from 1.
        marked: comment lines with a number for every column but the first.
        comments: for each comment line in the data, the row after it, without counting comments.
    """

    data: TextData
    header_row: int
    marked: list[int]
    comments: list[int] = field(default_factory=list[int])

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Read as in `LogTable.rows`.

        Raises:
            RecordingError: a line has another number of fields than the header, or the first one
                holds no numbers.
        """
        places = [self.header.index(pick.field.name) for pick in self.picks(columns)]
        decimals = Decimals(self.data.separator)
        for row, block in _blocks(self):
            fields = _fields(self, block, row)
            texts = [fields.to_series(k).str.strip_chars() for k in places]
            numbers = decimals.numbers(texts)
            if row == self.first_row and not any(map(_is_figure, (x[0] for x in texts))):
                raise RecordingError(
                    "holds no numbers, as if it were a row of units",
                    where=self.row_place(row),
                    cure=f"delete the row, or give --columns a mapping with data_row: {row + 1}, "
                    "and declare the units there",
                )
            yield Rows(numbers, texts)
        self.doubts.clear()
        if self.marked:
            self.doubts.append(
                Doubt(
                    f"lines that begin with a comment mark are ignored, but {len(self.marked)} of "
                    "them hold a number for every other column, the first in row "
                    f"{self.marked[0]}",
                    cause="rows were commented out by hand",
                    cure="if they are data, remove the mark",
                )
            )
        if self.data.ends_open:
            self.doubts.append(NO_LINE_BREAK)

    @property
    def header_place(self) -> str:
        return self.row_place(self.header_row)

    def row_name(self, row: int) -> str:
        """Place of a row, counted as an editor counts lines, with comment lines in the data."""
        return f"row {row + bisect_right(self.comments, row)}"

    def cure(self, written: str) -> str:
        if written in self.header:
            return "the header is repeated here: split the file, for another recording begins"
        if "," in written and self.data.separator == "," and not _THOUSANDS.fullmatch(written):
            return "decimal commas need semicolons or tabs between the columns"
        cures = (cure for pattern, cure in _CURES if pattern.fullmatch(written))
        return next(cures, super().cure(written))


def _is_figure(written: str | None) -> bool:
    return bool(written) and (is_number(written) or _FORTRAN.fullmatch(written) is not None)


def _blocks(table: CsvTable) -> Iterator[tuple[int, bytes]]:
    """Blocks of lines with their first rows, without empty lines at the end of the file."""
    row, empty_row, comments, separator = table.first_row, 0, 0, table.data.separator
    for whole in table.data.blocks():
        block, in_block = _without_comments(whole, separator, row)
        # Later passes find the same comments again.
        for after, line in in_block[max(0, len(table.comments) - comments) :]:
            if is_marked_row(line, separator, len(table.header)):
                table.marked.append(after + len(table.comments))
            table.comments.append(after)
        comments += len(in_block)
        if not block:
            continue
        if separator == " ":
            block = _single_blanks(block)
        size = len(block.rstrip(b" \t\r\n\x0b\x0c" + separator.encode()))
        filled = block[: (block.find(b"\n", size) + 1) or len(block)] if size else b""
        if filled and empty_row:
            raise _empty_line(table, empty_row)
        if filled:
            yield row, filled
        if len(filled) < len(block) and not empty_row:
            empty_row = row + filled.count(b"\n")
        row += block.count(b"\n") + (not block.endswith(b"\n"))


def _without_comments(
    block: bytes, separator: str, row: int
) -> tuple[bytes, list[tuple[int, bytes]]]:
    """A block without comments, and its comment lines with the rows after them."""
    marks = [b"#", b"%", b"//"] + [b";"] * (separator != ";")
    comments, parts, start = list[tuple[int, bytes]](), list[bytes](), 0
    if not any(mark in block for mark in marks):
        return block, comments
    for match in re.finditer(rb"(?m)^ *(?:" + b"|".join(marks) + rb")[^\n]*\n?", block):
        parts.append(block[start : match.start()])
        row += parts[-1].count(b"\n")
        comments.append((row, match[0]))
        start = match.end()
    return b"".join([*parts, block[start:]]), comments


def _single_blanks(block: bytes) -> bytes:
    block = block.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    block = block.replace(b"\n ", b"\n").replace(b" \n", b"\n")
    return block.removeprefix(b" ").removesuffix(b" ")


def _fields(table: CsvTable, block: bytes, row: int) -> pl.DataFrame:
    lines, frame = _require_fields(table, block, row), None
    with suppress(*POLARS_ERRORS):
        frame = pl.read_csv(
            io.BytesIO(block),
            has_header=False,
            separator=table.data.separator,
            infer_schema=False,
            encoding="utf8-lossy",  # only unused columns may be in other encodings
        )
    if frame is None or frame.shape != (lines, len(table.header)):
        first, last = (table.row_name(end).removeprefix("row ") for end in (row, row + lines - 1))
        raise RecordingError(
            "are not valid CSV",
            where=f"{table.path}, rows {first} to {last}",
            cure="look there for stray quotation marks",
        )
    return frame


def _require_fields(table: CsvTable, block: bytes, row: int) -> int:
    """Number of lines of a block; refuses lines with another number of fields than the header."""
    data, ends, wanted = np.frombuffer(block, np.uint8), line_ends(block), len(table.header)
    marks = np.flatnonzero(data == ord(table.data.separator))
    unclosed = np.zeros(0, dtype=int)
    if b'"' in block:
        quotes = np.flatnonzero(data == ord('"'))
        unclosed = np.flatnonzero(per_line(quotes, ends) % 2)
        marks = marks[np.searchsorted(quotes, marks) % 2 == 0]
    fields = per_line(marks, ends) + 1
    ragged = np.flatnonzero(fields != wanted)
    if unclosed.size and not (ragged.size and ragged[0] < unclosed[0]):
        raise RecordingError(
            "has a quotation mark that is not closed",
            where=table.row_place(row + int(unclosed[0])),
            cure="repair or remove the row",
        )
    for i in ragged[:1].tolist():
        if not block[ends[i - 1] + 1 if i else 0 : ends[i]].strip():
            raise _empty_line(table, row + i)
        cure = "repair the line or remove it"
        if fields[i] < wanted and i == len(ends) - 1 and not block.endswith(b"\n"):
            cure = "the file is cut off there; delete the line or export the log again"
        elif fields[i] > wanted and table.data.separator == ",":
            cure = "repair the line; decimal commas need semicolons or tabs between the columns"
        raise RecordingError(
            f"has {fields[i]} fields, but the header has {wanted}",
            where=table.row_place(row + i),
            cure=cure,
        )
    return len(ends)


def _empty_line(table: CsvTable, row: int) -> RecordingError:
    return RecordingError(
        "is an empty line, but more data follows",
        where=table.row_place(row),
        cure="remove it; if samples are missing there, split the log",
    )
