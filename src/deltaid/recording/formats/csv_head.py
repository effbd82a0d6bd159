"""The first lines of a CSV file as text: comments, separator, cells and names."""

import csv
import io
import re
from pathlib import Path

from deltaid.errors import RecordingError
from deltaid.recording.formats.csv_end import is_number

LONGEST_LINE = 1 << 20
SEPARATORS = ("\t", ";", ",")
COMMENT = re.compile(r"\A\s*(?:#|%|//|;(?=[^;]*$))+")


class HeadLines:
    """The lines from the start of a file, read as they are asked for."""

    def __init__(self, file: io.BufferedReader, path: Path) -> None:
        self._file, self._path = file, path
        self._lines: list[bytes] = []

    def __getitem__(self, row: int) -> bytes:
        """A line, counted from 1; nothing behind the end of the file."""
        while len(self._lines) < row:
            self._lines.append(_line(self._file, self._path, len(self._lines) + 1))
        return self._lines[row - 1]

    def size(self, rows: int) -> int:
        """Of the first lines together [bytes]."""
        return sum(map(len, self._lines[:rows]))


def is_comment(line: bytes) -> bool:
    """Whether a line near the head of a file says nothing but remarks."""
    return bool(COMMENT.match(line.decode("latin-1")))


def _line(file: io.BufferedReader, path: Path, row: int) -> bytes:
    line = file.readline(LONGEST_LINE)
    if len(line) == LONGEST_LINE:
        raise RecordingError(
            "is too long for a line of CSV",
            where=f"{path}, row {row}",
            cure="export the log as CSV with a line break after every sample, or as Parquet",
        )
    return line


def as_text(line: bytes) -> str:
    """A line as text. What is not UTF-8 comes from Windows, where ° is one byte."""
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("cp1252", errors="replace")
    return text.rstrip("\r\n")


def decoded(line: bytes, place: str) -> str:
    """The header as text."""
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
    """The separator of a header: tab before semicolon before comma, since names may hold commas.

    One that only follows another (`t,<tab>q1`) is padding. Where there is none of them, or numbers
    with decimal commas stand apart, it is runs of blanks.
    """
    unquoted = re.sub(r'"[^"]*"', "", header)
    for mark in SEPARATORS[:-1]:
        fields = unquoted.split(mark)
        if len(fields) > 1 and not any(f.rstrip().endswith(SEPARATORS) for f in fields):
            return mark
    words = unquoted.split()
    apart = len(words) > 1 and all(is_number(w) and not w.endswith(",") for w in words)
    if apart or (len(words) > 1 and "," not in unquoted):
        return " "
    return SEPARATORS[-1]


def cells_of(text: str, separator: str) -> list[str]:
    text = text.strip() if separator == " " else text
    fields = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    return [field.strip() for field in fields]


def names_in(text: str, separator: str, place: str) -> tuple[str, ...]:
    """The names of a row.

    Raises:
        RecordingError: it is none.
    """
    try:
        return tuple(cells_of(text, separator))
    except csv.Error as error:
        raise RecordingError(
            f"is not a row of column names: {error}",
            where=place,
            cure="mend it, or say with --columns MAPPING.yaml (header_row) where the names are",
        ) from None
