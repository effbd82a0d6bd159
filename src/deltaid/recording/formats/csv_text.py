"""Reading CSV in blocks of lines: decimal commas, quotes, and the line of each fault.

A block ends where a line ends, so fields are counted before polars parses it and every row keeps
its line number. Fields are read as text, because only then the place of a bad number is known.
"""

import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Int

from deltaid.errors import RecordingError
from deltaid.recording.formats.csv_end import is_marked_row
from deltaid.recording.formats.csv_head import LONGEST_LINE
from deltaid.recording.formats.csv_layout import CsvLayout
from deltaid.recording.formats.stream import content, skip
from deltaid.recording.source import Rows
from deltaid.recording.time.seconds import is_clock

_BLOCK_BYTES = 4 << 20


def read_csv(table: CsvLayout, at: Sequence[int]) -> Iterator[Rows]:
    """Some columns by their numbers from 0.

    Raises:
        RecordingError: a line has not the header's fields, or the first one holds no numbers.
    """
    decimals = Decimals(table.separator)
    for row, block in _blocks(table):
        fields = _fields(table, block, row)
        texts = [fields.to_series(i).str.strip_chars() for i in at]
        numbers = decimals.numbers(texts)
        if row == table.first_row and all(series[0] is None for series in numbers):
            raise _row_of_units(table)
        yield Rows(numbers, texts)


def _blocks(table: CsvLayout) -> Iterator[tuple[int, bytes]]:
    """Whole lines with the row of the first, without the empty lines at the end of the file."""
    row, empty_row, comments = table.first_row, 0, 0
    for whole in whole_lines(table.path, table.data_start, table.data_size):
        block, found = _without_comments(whole, table.separator, row)
        # A later pass meets the same comments again.
        for at, line in found[max(0, len(table.comments) - comments) :]:
            if is_marked_row(line, table.separator, len(table.header)):
                table.marked.append(at + len(table.comments))
            table.comments.append(at)
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
    """A block without its comment lines, and each of them with the row after it."""
    marks = [b"#", b"%", b"//"] + [b";"] * (separator != ";")
    if not any(mark in block for mark in marks):
        return block, []
    found, start = list[tuple[int, bytes]](), 0
    parts: list[bytes] = []
    for match in re.finditer(rb"(?m)^ *(?:" + b"|".join(marks) + rb")[^\n]*\n?", block):
        kept = block[start : match.start()]
        parts.append(kept)
        row += kept.count(b"\n")
        found.append((row, match[0]))
        start = match.end()
    return b"".join([*parts, block[start:]]), found


def _single_blanks(block: bytes) -> bytes:
    """Lines with one blank between their fields."""
    block = block.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    block = block.replace(b"\n ", b"\n").replace(b" \n", b"\n")
    return block.removeprefix(b" ").removesuffix(b" ")


def whole_lines(path: Path, start: int, size: int) -> Iterator[bytes]:
    """A part of a file in blocks that end where a line ends.

    Raises:
        RecordingError: it has no lines of a length that can be.
    """
    with content(path) as file:
        skip(file, start)
        rest, left = b"", size
        while block := file.read(min(_BLOCK_BYTES, left)):
            left -= len(block)
            cut = block.rfind(b"\n") + 1
            if cut:
                yield rest + block[:cut]
                rest = block[cut:]
            else:
                rest += block
            if len(rest) > LONGEST_LINE + _BLOCK_BYTES:
                raise RecordingError(
                    "has lines that are too long for CSV",
                    where=str(path),
                    cure="export the log with a line break after every sample, or as Parquet",
                )
        if rest:
            yield rest


def _without_empty_end(block: bytes, separator: str) -> bytes:
    """A block up to its last line that holds something."""
    blank = b" \t\r\n\x0b\x0c" + separator.encode()
    stop = len(block)
    while stop:
        start = block.rfind(b"\n", 0, stop - 1) + 1
        if block[start:stop].strip(blank):
            break
        stop = start
    return block[:stop]


def _fields(table: CsvLayout, block: bytes, row: int) -> pl.DataFrame:
    """The fields of a block as text, one row a line."""
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
        last = row + lines - 1
        raise RecordingError(
            "are not valid CSV",
            where=f"{table.path}, rows {table.line(row)} to {table.line(last)}",
            cure="look there for stray quotation marks",
        )
    return frame


def _require_fields(table: CsvLayout, block: bytes, row: int) -> int:
    """The number of lines of a block, each with as many fields as the header has."""
    data = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    if not block.endswith(b"\n"):
        ends = np.append(ends, len(data))
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


def per_line(
    positions: Int[np.ndarray, " marks"], ends: Int[np.ndarray, " lines"]
) -> Int[np.ndarray, " lines"]:
    """How many of some sorted positions lie in each line, by where the lines end."""
    return np.diff(np.searchsorted(positions, ends), prepend=0)


def _ragged(table: CsvLayout, row: int, line: bytes, fields: int, at_end: bool) -> RecordingError:
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


def _empty_line(table: CsvLayout, row: int) -> RecordingError:
    return RecordingError(
        "is an empty line, but more data follows",
        where=table.row_place(row),
        cure="remove it; if samples are missing there, split the log",
    )


class Decimals:
    """Whether a file has decimal commas, which the first number that is not whole decides.

    With commas between the columns there is no question. Numbers written the other way are none.
    """

    def __init__(self, separator: str) -> None:
        self._mark = "." if separator == "," else ""

    def numbers(self, texts: list[pl.Series]) -> list[pl.Series]:
        """Text as numbers, null where it is none."""
        # Fractions of a second have a mark of their own.
        self._mark = self._mark or _first_mark([x for x in texts if len(x) and not is_clock(x[0])])
        if self._mark == ",":
            texts = [_with_points(text) for text in texts]
        return [text.cast(pl.Float64, strict=False) for text in texts]


def _with_points(text: pl.Series) -> pl.Series:
    pointed = text.str.contains(".", literal=True)
    return text.str.replace(",", ".", literal=True).set(pointed, None)


def _first_mark(texts: list[pl.Series]) -> str:
    """The decimal mark in the first row that has one; none if all numbers are whole."""

    first: dict[int, str] = {}
    for mark in (".", ","):
        found = [text.str.contains(mark, literal=True).arg_true() for text in texts]
        rows = [int(row[0]) for row in found if len(row)]
        if rows:
            first[min(rows)] = mark
    return first[min(first)] if first else ""


def _row_of_units(table: CsvLayout) -> RecordingError:
    return RecordingError(
        "holds no numbers, as if it were a row of units",
        where=table.row_place(table.first_row),
        cure=f"delete the row, or give --columns a mapping with data_row: {table.first_row + 1}, "
        "and declare the units there",
    )
