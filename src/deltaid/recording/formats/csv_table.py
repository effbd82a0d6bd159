"""Reading CSV in blocks of lines: decimal commas, quotes, and the line of each fault.

A block ends where a line ends, so fields are counted before polars parses it and every row keeps
its line number. Fields are read as text, because only then the place of a bad number is known.
"""

import io
import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.formats.csv_lines import (
    NO_LINE_BREAK,
    Decimals,
    is_marked_row,
    line_ends,
    per_line,
    whole_lines,
)
from deltaid.recording.source import LogTable, Rows


@dataclass(frozen=True)
class CsvTable(LogTable):
    """An open CSV file, of which a block is in memory at a time; rows are lines of the file.

    Attributes:
        separator: between its fields.
        header_row: line of the names, from 1.
        data_start, data_size: where the data starts, and how much there is [bytes].
        ends_open: whether the file ends without a line break.
        marked: comment lines that hold a number for every column but the first.
        comments: for each comment line that was met among the data, the row after it, comments not
            counted.
    """

    separator: str
    header_row: int
    data_start: int
    data_size: int
    ends_open: bool
    marked: list[int]
    comments: list[int] = field(default_factory=list[int])

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """As in `LogTable.rows`.

        Raises:
            RecordingError: a line has not the header's fields, or the first one holds no numbers.
        """
        places = [self.header.index(pick.field.name) for pick in self.picks(columns)]
        decimals = Decimals(self.separator)
        for row, block in _blocks(self):
            fields = _fields(self, block, row)
            texts = [fields.to_series(k).str.strip_chars() for k in places]
            numbers = decimals.numbers(texts)
            if row == self.first_row and all(series[0] is None for series in numbers):
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
        if self.ends_open:
            self.doubts.append(NO_LINE_BREAK)

    @property
    def header_place(self) -> str:
        """The line of the names."""
        return self.row_place(self.header_row)

    def row_place(self, row: int) -> str:
        """One row, counted as an editor counts lines: with the comment lines among the data."""
        return f"{self.path}, row {row + bisect_right(self.comments, row)}"

    def cure(self, written: str) -> str:
        """What to do about a field that is no number, by its marks."""
        if "," in written and self.separator == ",":
            return "decimal commas need semicolons or tabs between the columns"
        if "," in written or "." in written:
            return "write all numbers in one way, with point or comma, and no thousands sign"
        return super().cure(written)


def _blocks(table: CsvTable) -> Iterator[tuple[int, bytes]]:
    """Whole lines with the row of the first, without the empty lines at the end of the file."""
    row, empty_row, comments = table.first_row, 0, 0
    for whole in whole_lines(table.path, table.data_start, table.data_size):
        block, found = _without_comments(whole, table.separator, row)
        # A later pass meets the same comments again.
        for after, line in found[max(0, len(table.comments) - comments) :]:
            if is_marked_row(line, table.separator, len(table.header)):
                table.marked.append(after + len(table.comments))
            table.comments.append(after)
        comments += len(found)
        if not block:
            continue
        if table.separator == " ":
            block = _single_blanks(block)
        lines = block.count(b"\n") + (not block.endswith(b"\n"))
        filled = _without_empty_end(block, table.separator)
        if filled and empty_row:
            raise _empty_line(table, empty_row)
        if filled:
            yield row, filled
        if len(filled) < len(block) and not empty_row:
            empty_row = row + filled.count(b"\n")
        row += lines


def _without_comments(
    block: bytes, separator: str, row: int
) -> tuple[bytes, list[tuple[int, bytes]]]:
    marks = [b"#", b"%", b"//"] + [b";"] * (separator != ";")
    if not any(mark in block for mark in marks):
        return block, []
    found, start = list[tuple[int, bytes]](), 0
    parts = list[bytes]()
    for match in re.finditer(rb"(?m)^ *(?:" + b"|".join(marks) + rb")[^\n]*\n?", block):
        kept = block[start : match.start()]
        parts.append(kept)
        row += kept.count(b"\n")
        found.append((row, match[0]))
        start = match.end()
    return b"".join([*parts, block[start:]]), found


def _single_blanks(block: bytes) -> bytes:
    block = block.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    block = block.replace(b"\n ", b"\n").replace(b" \n", b"\n")
    return block.removeprefix(b" ").removesuffix(b" ")


def _without_empty_end(block: bytes, separator: str) -> bytes:
    filled = len(block.rstrip(b" \t\r\n\x0b\x0c" + separator.encode()))
    end = block.find(b"\n", filled) + 1
    return block[: end or len(block)] if filled else b""


def _fields(table: CsvTable, block: bytes, row: int) -> pl.DataFrame:
    lines = _require_fields(table, block, row)
    try:
        frame = pl.read_csv(
            io.BytesIO(block),
            has_header=False,
            separator=table.separator,
            infer_schema=False,
            encoding="utf8-lossy",  # only columns that are not used may hold other encodings
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
        frame = None
    if frame is None or frame.shape != (lines, len(table.header)):
        first, last = (table.row_name(end).removeprefix("row ") for end in (row, row + lines - 1))
        raise RecordingError(
            "are not valid CSV",
            where=f"{table.path}, rows {first} to {last}",
            cure="look there for stray quotation marks",
        )
    return frame


def _require_fields(table: CsvTable, block: bytes, row: int) -> int:
    """The number of lines of a block, each with as many fields as the header has."""
    data, ends = np.frombuffer(block, np.uint8), line_ends(block)
    marks = np.flatnonzero(data == ord(table.separator))
    unclosed = np.zeros(0, dtype=int)
    if b'"' in block:
        quotes = np.flatnonzero(data == ord('"'))
        unclosed = np.flatnonzero(per_line(quotes, ends) % 2)
        marks = marks[np.searchsorted(quotes, marks) % 2 == 0]
    fields = per_line(marks, ends) + 1
    ragged = np.flatnonzero(fields != len(table.header))
    if unclosed.size and not (ragged.size and ragged[0] < unclosed[0]):
        raise RecordingError(
            "has a quotation mark that is not closed",
            where=table.row_place(row + int(unclosed[0])),
            cure="repair or remove the row",
        )
    if ragged.size:
        i = int(ragged[0])
        start = int(ends[i - 1]) + 1 if i else 0
        at_end = i == len(ends) - 1 and not block.endswith(b"\n")
        raise _ragged(table, row + i, block[start : int(ends[i])], int(fields[i]), at_end)
    return len(ends)


def _ragged(table: CsvTable, row: int, line: bytes, fields: int, at_end: bool) -> RecordingError:
    if not line.strip():
        return _empty_line(table, row)
    wanted = len(table.header)
    if at_end and fields < wanted:
        cure = "the file is cut off there; delete the line or export the log again"
    elif fields > wanted and table.separator == ",":
        cure = "repair the line; decimal commas need semicolons or tabs between the columns"
    else:
        cure = "repair the line or remove it"
    return RecordingError(
        f"has {fields} fields, but the header has {wanted}", where=table.row_place(row), cure=cure
    )


def _empty_line(table: CsvTable, row: int) -> RecordingError:
    return RecordingError(
        "is an empty line, but more data follows",
        where=table.row_place(row),
        cure="remove it; if samples are missing there, split the log",
    )
