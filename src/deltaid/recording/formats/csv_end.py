"""How a CSV file ends: with data, or with lines of text such as END that belong to no sample."""

import io
import re
from dataclasses import dataclass

from deltaid.errors import Doubt
from deltaid.recording.formats.stream import skip

NO_LINE_BREAK = Doubt(
    "the last line has no line break, so its last number may be cut off",
    cause="the file was copied while it was being written, or the disk was full",
    cure="nothing is to be done if the file is whole; else remove the line",
)
_TAIL = 1 << 16
_LINES = 3


@dataclass(frozen=True)
class End:
    """The end of a CSV file.

    Attributes:
        size: of the data [bytes].
        tag: the text after the data; empty if there is none.
        last_byte: of the file; empty if there is no data.
    """

    size: int
    tag: str
    last_byte: bytes


def find_end(file: io.BufferedReader, data_start: int, separator: str) -> End:
    """Where the data ends that begins at an offset.

    What is compressed has to be unpacked for it once more.
    """
    skip(file, data_start)
    size, tail = _tail(file)
    stop, tag = len(tail), ""
    for _ in range(_LINES):
        filled = len(tail[:stop].rstrip())
        start = tail.rfind(b"\n", 0, filled) + 1
        line = tail[start:filled].decode("latin-1").strip()
        if not start or not _is_text(line, separator):
            break
        stop, tag = start, line
    shown = "".join(c if c.isprintable() else "?" for c in tag[:40])
    return End(size - len(tail) + stop, shown, tail[-1:])


def is_marked_row(line: bytes, separator: str, columns: int) -> bool:
    """Whether a comment line might be a row of data: all fields but the first are numbers."""
    text = line.decode("latin-1").strip()
    fields = text.split(None if separator == " " else separator)
    return 1 < columns == len(fields) and all(is_number(field) for field in fields[1:])


def is_number(text: str) -> bool:
    """Whether a field is empty or a number with decimal point or comma."""
    try:
        float(text.replace(",", ".", 1) or 0)
    except ValueError:
        return False
    return True


def _tail(file: io.BufferedReader) -> tuple[int, bytes]:
    """How much there is from here on, and the last part of it."""
    if file.seekable():
        at = file.tell()
        size = file.seek(0, io.SEEK_END) - at
        file.seek(at + max(0, size - _TAIL))
        return size, file.read()
    size, tail = 0, b""
    while part := file.read(_TAIL):
        size += len(part)
        tail = (tail + part)[-_TAIL:]
    return size, tail


def _is_text(line: str, separator: str) -> bool:
    """Whether a line holds words and no number at all."""
    fields = [field.strip(' "') for field in line.split(separator)]
    return bool(re.match(r"[^\W\d_]", line)) and not any(f and is_number(f) for f in fields)
