"""Opens text exports of TwinCAT Scope: rows about channels, then columns of times and values.

    Name    q1              Name    tau1    tau2            (tabs between them)
    Unit    rad (Angle)     Unit    Nm (Torque)     …
    0       0,5             0       1,5     2,5
    1       0,6             0,25    1,6     2,6

The word of each row is repeated above the column of times of every group of channels. A group is
one channel (Timelines: All) or all channels of one period (For each sampletime). Slower channels
end sooner, so a line is not one instant. Options of the export determine the rows, the separator
and the decimal mark.
"""

import re
from collections import Counter
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

from deltaid.errors import RecordingError, visible
from deltaid.recording.address import RecordedField
from deltaid.recording.formats.csv_lines import (
    SEARCHED_LINES,
    HeadLines,
    as_text,
    cells_of,
    is_number,
)
from deltaid.recording.formats.twincat_table import NEUTRAL, TIME, ScopeChannel, ScopeTable
from deltaid.recording.source import LogTable, content

# Number of lines of data that determine the columns.
_SHOWING_LINES = 50
_NAMES = ("Name", "SymbolName")
_WORDS = {*_NAMES, *NEUTRAL, "Unit"}
_FIRST = re.compile(rb'\A(?:\xef\xbb\xbf)?"?Name"?(?P<separator>[^\w"\r\n])')
# Words at the beginning of lines that hardly occur in other files.
_MARKS = re.compile(
    rb'\n"?(?:File|Starttime of export|StartRecord|SymbolName|SymbolComment|Data-Type|NetI[dD]|'
    rb'SampleTime\[ms\]|IndexGroup)"?[^\w"\r\n]'
)
# The year 1970 in Windows time, 100 ns since 1601; times in ms are always smaller.
_FILE_TIME = (datetime(1970, 1, 1) - datetime(1601, 1, 1)) // timedelta(microseconds=1) * 10


def is_scope(start: bytes, path: Path) -> bool:
    """Whether a file is an export, by the first words of its first lines."""
    first = _FIRST.match(start)
    if not first:
        return False
    line, separator = start.split(b"\n", 1)[0], first["separator"]
    return bool(_MARKS.search(start)) or separator + b"Name" + separator in line


def open_scope(path: Path) -> LogTable:
    """Open an export of any layout.

    Raises:
        RecordingError: its rows of names, its times or its data are missing.
    """
    with content(path) as file:
        lines = HeadLines(file, path)
        first = _FIRST.match(lines[1])
        separator = first["separator"].decode("latin-1") if first else "\t"
        rows, first_row = _rows(lines, separator, path)
        shown = [_cells(lines[first_row + k], separator) for k in range(_SHOWING_LINES)]
        ends_on_separator = as_text(lines[first_row]).endswith(separator)
        data = lines.data(first_row, separator)
    widest = max(len(cells) for cells in shown) - ends_on_separator
    names = next((rows[word] for word in _NAMES if len(rows.get(word, ())) >= widest), [])
    heads = [k for k, name in enumerate(names) if name == names[0]]
    blanks = separator == " " and len(names) != widest
    if not names or len(names) - len(heads) >= widest or blanks:
        count = max(len(rows.get(word, ())) for word in _NAMES)
        raise RecordingError(
            f"has {widest} columns of data, but {count} names, times included",
            where=f"{path}, row {first_row}",
            cure="export with a header and with times (Timelines: All, or For each "
            "sampletime), separated by tabs or semicolons: names may hold blanks, and numbers "
            "commas",
        )
    times = [shown[0][k] for k in heads if k < len(shown[0]) and shown[0][k].isdecimal()]
    origin = min(map(int, times), default=0)
    channels = tuple(_channels(rows, names, heads))
    by_name = {trace.name: trace for trace in reversed(channels) if trace.name}
    symbols = Counter(trace.symbol for trace in channels if trace.symbol not in ("", *by_name))
    by_symbol = {trace.symbol: trace for trace in channels if symbols[trace.symbol] == 1}
    traces = by_name | by_symbol
    named = [TIME, *(trace.name for trace in channels if trace.name), *by_symbol]
    return ScopeTable(
        path,
        tuple(map(RecordedField, named)),
        data,
        len(names),
        ends_on_separator,
        origin if origin > _FILE_TIME else None,
        channels,
        traces,
        first_row=first_row,
        units={name: trace.unit for name, trace in traces.items() if trace.unit},
    )


def _rows(lines: HeadLines, separator: str, path: Path) -> tuple[dict[str, list[str]], int]:
    """Rows about channels by their words, and the first row of data.

    If a word has several rows, the last one counts, because the project has a name too. Comments of
    symbols may have several lines.
    """
    rows: dict[str, list[str]] = {}
    for row, line in lines.first(SEARCHED_LINES):
        cells = _cells(line, separator)
        if cells[0] in _WORDS:
            last = max(k for k, cell in enumerate(cells) if cell)
            rows[cells[0]] = [visible(cell) for cell in cells[: last + 1]]
        elif len(cells) > 1 and any(cells) and all(map(is_number, cells)):
            return rows, row
    raise RecordingError(
        "is an export of TwinCAT Scope without data",
        where=str(path),
        cure="export it again; the numbers are expected under the rows about the channels",
    )


def _channels(
    rows: dict[str, list[str]], names: list[str], heads: list[int]
) -> Iterator[ScopeChannel]:
    def cell(word: str, k: int) -> str:
        row = rows.get(word, [])
        return row[k] if len(row) <= len(names) and k < len(row) else ""

    for start, stop in zip(heads, [*heads[1:], len(names)], strict=True):
        for k in range(start + 1, stop):
            unit = cell("Unit", k).rsplit(" (", 1)[0]
            yield ScopeChannel(
                names[k],
                cell("SymbolName", k),
                start,
                k,
                "" if unit == "(None)" else unit,
                {word: value for word in NEUTRAL if (value := cell(word, k))},
            )


def _cells(line: bytes, separator: str) -> list[str]:
    text = as_text(line)
    return cells_of(text, separator) or [field.strip() for field in text.split(separator)]
