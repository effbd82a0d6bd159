"""Lines of a text file: its head, its data in blocks of lines, cells and numbers.

The head has comments and names. The file ends with data, or with lines of text such as END.
"""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Int

from deltaid.errors import Doubt, RecordingError, visible
from deltaid.recording.source import content, damage
from deltaid.recording.time.counts import is_clock

# Longest line [bytes], so that files without line breaks are refused early.
_LONGEST_LINE = 1 << 20
# Number of first lines in which names, or the first data, are searched.
SEARCHED_LINES = 500
# Number of bytes that are read at once.
_BLOCK_BYTES = 4 << 20
SEPARATORS = ("\t", ";", ",")
COMMENT = re.compile(r"\A\s*(?:#|%|//|;(?=[^;]*$))+")
# Line that states the separator, for spreadsheets; it is ignored, because names show it too.
_HINT = re.compile(rb'\A(?:\xef\xbb\xbf)?"?sep=.?"?\s*\Z', re.IGNORECASE)
NO_LINE_BREAK = Doubt(
    "the last line has no line break, so its last number may be cut off",
    cause="the file was copied while it was being written, or the disk was full",
    cure="no action is needed if the file is whole; else remove the line",
)


class HeadLines:
    """Lines from the start of a file, read on demand."""

    def __init__(self, file: io.BufferedReader, path: Path) -> None:
        self._file, self._path = file, path
        self._lines: list[bytes] = []

    def __getitem__(self, row: int) -> bytes:
        """Line by its number from 1; empty beyond the end of the file.

        Raises:
            RecordingError: the line is too long.
        """
        while len(self._lines) < row:
            line = self._file.readline(_LONGEST_LINE)
            if len(line) == _LONGEST_LINE:
                raise RecordingError(
                    "is too long for a line of CSV",
                    where=f"{self._path}, row {len(self._lines) + 1}",
                    cure="export the log as CSV with a line break after every sample, or as "
                    "Parquet",
                )
            if not line:
                return b""
            self._lines.append(line)
        return self._lines[row - 1]

    def first(self, rows: int) -> Iterator[tuple[int, bytes]]:
        """First `rows` lines with their numbers, or all lines of a shorter file."""
        return enumerate(takewhile(bool, (self[row] for row in range(1, rows + 1))), start=1)

    def data(self, first_row: int, separator: str) -> "TextData":
        """Data from `first_row` on; reads the file to its end."""
        before = self[first_row - 1] if first_row > 1 else b""
        start = sum(map(len, self._lines[: first_row - 1]))
        tail = b"".join(self._lines[first_row - 1 :])
        size = len(tail)
        if self._file.seekable():
            size = self._file.seek(0, io.SEEK_END) - start
            self._file.seek(start + max(0, size - _LONGEST_LINE))
            tail = self._file.read()
        while part := self._file.read(_LONGEST_LINE):
            size, tail = size + len(part), (tail + part)[-_LONGEST_LINE:]
        stop, tag = len(tail), ""
        for _ in range(3):
            filled = len(tail[:stop].rstrip())
            first = tail.rfind(b"\n", 0, filled) + 1
            line = tail[first:filled].decode("latin-1").strip()
            fields = [field.strip(' "') for field in line.split(separator)]
            is_text = re.match(r"[^\W\d_]", line) and not any(f and is_number(f) for f in fields)
            if not first or not is_text:
                break
            stop, tag = first, line
        ends_open, size = not (tail or before).endswith(b"\n"), size - len(tail) + stop
        return TextData(self._path, separator, start, size, visible(tag[:40], kept=""), ends_open)


@dataclass(frozen=True)
class TextData:
    """Lines of data of a text file.

    Attributes:
        path: path of the file.
        separator: separator of fields.
        start, size: place of the data in the file [bytes].
        tag: text behind the data; empty without such text.
        ends_open: whether the file ends without a line break.
    """

    path: Path
    separator: str
    start: int
    size: int
    tag: str
    ends_open: bool

    def blocks(self) -> Iterator[bytes]:
        """Blocks of whole lines.

        Raises:
            RecordingError: a line is too long.
        """
        with content(self.path) as file:
            file.read(self.start)
            rest, remaining = b"", self.size
            while block := file.read(min(_BLOCK_BYTES, remaining)):
                remaining -= len(block)
                if cut := block.rfind(b"\n") + 1:
                    yield rest + block[:cut]
                rest = block[cut:] if cut else rest + block
                if len(rest) > _LONGEST_LINE + _BLOCK_BYTES:
                    raise RecordingError(
                        "has lines that are too long for CSV",
                        where=str(self.path),
                        cure="export the log with a line break after every sample, or as Parquet",
                    )
            if rest:
                yield rest


def is_comment(line: bytes) -> bool:
    return bool(COMMENT.match(as_text(line)) or _HINT.match(line))


def as_text(line: bytes) -> str:
    """Line as text: in UTF-8, or else in the code page of Windows, in which ° is one byte."""
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("cp1252", errors="replace")
    return text.rstrip("\r\n")


def decoded(line: bytes, place: str) -> str:
    text = as_text(line)
    if "\r" in text:
        raise RecordingError(
            "has carriage returns alone as line breaks", where=place, cure="convert them to LF"
        )
    if any(ord(c) < 32 and c != "\t" for c in text):
        raise RecordingError(
            "is not text", where=place, cure="export the log as CSV in UTF-8 or as Parquet"
        )
    if not text.strip():
        raise RecordingError(
            "is an empty line where the column names are expected",
            where=place,
            cure="delete it, or give --columns a mapping with header_row",
        )
    return text


def separator_of(header: str) -> str:
    """Separator of a header: tab before semicolon before comma, because names may hold commas.

    A separator behind another one (`t,<tab>q1`) is padding. If there is none, or numbers have
    decimal commas, runs of blanks separate the fields.
    """
    unquoted = re.sub(r'"[^"]*"', "", header)
    for mark in SEPARATORS[:-1]:
        fields = unquoted.split(mark)
        if len(fields) > 1 and not any(f.rstrip().endswith(SEPARATORS) for f in fields):
            return mark
    words = unquoted.split()
    apart = len(words) > 1 and all(is_number(w) and not w.endswith(",") for w in words)
    return " " if apart or (len(words) > 1 and "," not in unquoted) else SEPARATORS[-1]


def cells_of(text: str, separator: str) -> list[str]:
    """Fields of a line; empty if the line is not valid CSV."""
    try:
        return list(names_in(text, separator, ""))
    except RecordingError:
        return []


def names_in(text: str, separator: str, place: str) -> tuple[str, ...]:
    """Names of columns in a row.

    Raises:
        RecordingError: the text is not valid CSV.
    """
    text = text.strip() if separator == " " else text
    cure = "fix it, or say with --columns MAPPING.yaml (header_row) where the names are"
    with damage(place, csv.Error, "is not a row of column names", cure):
        fields = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    return tuple(field.strip() for field in fields)


def is_marked_row(line: bytes, separator: str, columns: int) -> bool:
    """Whether a comment line may be a row of data: all fields but the first are numbers."""
    fields = line.decode("latin-1").strip().split(None if separator == " " else separator)
    return 1 < columns == len(fields) and all(is_number(field) for field in fields[1:])


def is_number(text: str) -> bool:
    """Whether a field is empty or a number with decimal point or comma."""
    try:
        float(text.replace(",", ".", 1) or 0)
    except ValueError:
        return False
    return True


def line_ends(block: bytes) -> Int[np.ndarray, " lines"]:
    """Ends of the lines of a block, including a last line without a line break."""
    ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
    return ends if block.endswith(b"\n") else np.append(ends, len(block))


def per_line(
    positions: Int[np.ndarray, " marks"], ends: Int[np.ndarray, " lines"]
) -> Int[np.ndarray, " lines"]:
    """Number of positions in each line, by the ends of the lines; positions are sorted."""
    return np.diff(np.searchsorted(positions, ends), prepend=0)


class Decimals:
    """Converts text to numbers with the decimal mark of the file's first number that has one.

    If commas separate columns, the mark is a point. Numbers with another mark are null.
    """

    def __init__(self, separator: str) -> None:
        self._mark = "." if separator == "," else ""

    def numbers(self, texts: list[pl.Series]) -> list[pl.Series]:
        """Convert text to numbers; other text becomes null."""
        if not self._mark:  # the mark in the first row that has one, times of day excepted
            plain = [text for text in texts if not is_clock(text)]
            marked = [
                (text.str.contains(m, literal=True).arg_true(), m) for m in ".," for text in plain
            ]
            rows = [(int(rows[0]), mark) for rows, mark in marked if len(rows)]
            self._mark = min(rows, default=(0, ""))[1]
        if self._mark == ",":  # null for numbers with a point
            texts = [text.set(text.str.contains(".", literal=True), None) for text in texts]
            texts = [text.str.replace(",", ".", literal=True) for text in texts]
        return [text.cast(pl.Float64, strict=False) for text in texts]
