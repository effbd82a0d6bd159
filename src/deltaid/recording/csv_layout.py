"""How a CSV file is laid out: where its names stand, what separates them, where the data begins."""

import csv
import io
import re
from pathlib import Path

from deltaid.errors import RecordingError
from deltaid.recording.source import Table
from deltaid.recording.stream import content

LONGEST_LINE = 1 << 20
_TAIL = 1 << 16
_SEPARATORS = ("\t", ";", ",")


def open_csv(path: Path, header_row: int = 1, data_row: int | None = None) -> Table:
    """The header of a CSV file.

    Raises:
        RecordingError: it is not text, or its header is missing.
    """
    first_row = data_row or header_row + 1
    with content(path) as file:
        lines = [_line(file, path, row + 1) for row in range(first_row - 1)]
        data_start = sum(map(len, lines))
        ends_open = not _tail(file, lines[-1]).endswith(b"\n")
    place = f"{path}, row {header_row}"
    text = _decoded(lines[header_row - 1], place)
    separator = _separator(text)
    names = _names(text, separator, place)
    return Table(path, names, separator, header_row, first_row, data_start, ends_open)


def _line(file: io.BufferedReader, path: Path, row: int) -> bytes:
    line = file.readline(LONGEST_LINE)
    if len(line) == LONGEST_LINE:
        raise RecordingError(
            "is too long for a line of CSV",
            where=f"{path}, row {row}",
            cure="export the log as CSV with a line break after every sample, or as Parquet",
        )
    return line


def _tail(file: io.BufferedReader, before: bytes) -> bytes:
    """The last part of a file, of which `before` is what was read last.

    What is compressed has to be unpacked for it once more.
    """
    if file.seekable():
        at = file.tell()
        file.seek(max(at, file.seek(0, io.SEEK_END) - _TAIL))
    tail = before
    while part := file.read(_TAIL):
        tail = (tail + part)[-_TAIL:]
    return tail


def _decoded(line: bytes, place: str) -> str:
    """The header as text. Names that are not UTF-8 come from Windows, where ° is one byte."""
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("cp1252", errors="replace")
    text = text.rstrip("\r\n")
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


def _separator(header: str) -> str:
    """The separator of a header: tab before semicolon before comma, since names may hold commas.

    One that only follows another (`t,<tab>q1`) is padding.
    """
    unquoted = re.sub(r'"[^"]*"', "", header)
    for mark in _SEPARATORS[:-1]:
        fields = unquoted.split(mark)
        if len(fields) > 1 and not any(f.rstrip().endswith(_SEPARATORS) for f in fields):
            return mark
    return _SEPARATORS[-1]


def _names(text: str, separator: str, place: str) -> tuple[str, ...]:
    try:
        fields = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        raise RecordingError(
            f"is not a row of column names: {error}",
            where=place,
            cure="mend it, or say with --columns MAPPING.yaml (header_row) where the names are",
        ) from None
    names = tuple(name.strip() for name in fields)
    if all(_is_number(name) for name in names):
        raise RecordingError(
            "has no header: its first row holds numbers",
            where=place,
            cure="put a row of column names first, such as t,q1,q2,q3,tau1,tau2,tau3",
        )
    return names


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", ".", 1) or 0)
    except ValueError:
        return False
    return True
