"""How TwinCAT Scope writes its text export: rows about channels, then columns of times and values.

    Name    q1              Name    tau1    tau2            (tabs between them)
    Unit    rad (Angle)     Unit    Nm (Torque)     …
    0       0,5             0       1,5     2,5
    1       0,6             0,25    1,6     2,6

The word of each row stands at the head of every group of channels, above its column of times: a
group is one channel (Timelines: All) or neighbours of one period (For each sampletime). Slower
channels simply end sooner: a line is not one instant. Which rows there are, the separator and the
decimal mark are options of the export.
"""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from deltaid.errors import RecordingError, visible
from deltaid.recording.formats.csv_end import find_end, is_number
from deltaid.recording.formats.csv_head import HeadLines, as_text
from deltaid.recording.formats.stream import content

_SEARCHED_LINES, _SHOWING_LINES = 500, 50
_NAMES = ("Name", "SymbolName")
_SCALES = ("ScaleFactor", "Offset", "Unit ScaleFactor", "Unit Offset")
_WORDS = {*_NAMES, *_SCALES, "Unit", "SampleTime[ms]"}
_FIRST = re.compile(rb'\A(?:\xef\xbb\xbf)?"?Name"?(?P<separator>[^\w"\r\n])')
# Words that stand at the head of a line of such a file and hardly of another.
_MARKS = re.compile(
    rb'\n"?(?:File|Starttime of export|StartRecord|SymbolName|SymbolComment|Data-Type|NetI[dD]|'
    rb'SampleTime\[ms\]|IndexGroup)"?[^\w"\r\n]'
)
# Times as Windows counts them, in 100 ns since 1601, are beyond this; in ms they never are.
_FILE_TIME = 1e16


@dataclass(frozen=True)
class Trace:
    """A channel: its names, where its columns are, and what the export says about it.

    Attributes:
        time, values: numbers of its columns.
        unit: empty if none is stated.
        scales: factor and offset of the channel and of its unit, as far as stated.
    """

    name: str
    symbol: str
    time: int
    values: int
    unit: str
    period: str
    scales: dict[str, str]


@dataclass(frozen=True)
class ScopeLayout:
    """How an export is written.

    Attributes:
        columns: how many there are, times included.
        ends_on_separator: whether lines have a separator after their last field.
        first_row: line of the first data, from 1.
        data_start, data_size: where the data starts, and how much there is [bytes].
        ends_open: whether the file ends without a line break.
        file_times: whether times are in 100 ns since 1601; else in ms since the first sample.
        origin: the first time of all.
    """

    path: Path
    separator: str
    columns: int
    ends_on_separator: bool
    first_row: int
    data_start: int
    data_size: int
    ends_open: bool
    file_times: bool
    origin: int
    traces: tuple[Trace, ...]


def is_scope(start: bytes) -> bool:
    """Whether a file begins as an export of TwinCAT Scope does."""
    first = _FIRST.match(start)
    if not first:
        return False
    line = start.split(b"\n", 1)[0]
    return bool(_MARKS.search(start)) or first["separator"] + b"Name" + first["separator"] in line


def open_scope(path: Path) -> ScopeLayout:
    """The layout of an export.

    Raises:
        RecordingError: its rows of names, its times or its data are missing.
    """
    with content(path) as file:
        lines = HeadLines(file, path)
        first = _FIRST.match(lines[1])
        separator = first["separator"].decode("latin-1") if first else "\t"
        rows, first_row = _rows(lines, separator, path)
        shown = [_cells(lines[first_row + k], separator) for k in range(_SHOWING_LINES)]
        data_start = lines.size(first_row - 1)
        ends_on_separator = as_text(lines[first_row]).endswith(separator)
    widest = max(len(cells) for cells in shown) - ends_on_separator
    names = next((rows[word] for word in _NAMES if len(rows.get(word, ())) >= widest), [])
    heads = [k for k, name in enumerate(names) if name == names[0]]
    blanks = separator == " " and len(names) != widest
    if not names or len(names) - len(heads) >= widest or blanks:
        found = max(len(rows.get(word, ())) for word in _NAMES)
        raise RecordingError(
            f"has {widest} columns of data, but {found} names, times included",
            where=f"{path}, row {first_row}",
            cure="export with a header and with times (Timelines: All, or For each sampletime), "
            "separated by tabs or semicolons: names may hold blanks, and numbers commas",
        )
    with content(path) as file:
        end = find_end(file, data_start, separator)
    times = [shown[0][k] for k in heads if k < len(shown[0]) and shown[0][k].isdecimal()]
    origin = min(map(int, times), default=0)
    return ScopeLayout(
        path,
        separator,
        len(names),
        ends_on_separator,
        first_row,
        data_start,
        end.size,
        not end.last_byte.endswith(b"\n"),
        origin > _FILE_TIME,
        origin if origin > _FILE_TIME else 0,
        _traces(rows, names, heads),
    )


def _rows(lines: HeadLines, separator: str, path: Path) -> tuple[dict[str, list[str]], int]:
    """The rows about channels by their words, and the first row of data.

    The last row of a word counts, since the project has a name as well. A comment of a symbol may
    go on over several lines.
    """
    rows: dict[str, list[str]] = {}
    for row in range(1, _SEARCHED_LINES + 1):
        if not lines[row]:
            break
        cells = _cells(lines[row], separator)
        if cells[0] in _WORDS:
            rows[cells[0]] = [visible(cell) for cell in _without_empty_end(cells)]
        elif len(cells) > 1 and any(cells) and all(map(is_number, cells)):
            return rows, row
    raise RecordingError(
        "is an export of TwinCAT Scope without data",
        where=str(path),
        cure="export it again; the numbers are expected under the rows about the channels",
    )


def _traces(rows: dict[str, list[str]], names: list[str], heads: list[int]) -> tuple[Trace, ...]:
    def cell(word: str, k: int) -> str:
        row = rows.get(word, [])
        return row[k] if len(row) <= len(names) and k < len(row) else ""

    traces: list[Trace] = []
    for start, stop in zip(heads, [*heads[1:], len(names)], strict=True):
        for k in range(start + 1, stop):
            unit = cell("Unit", k).rsplit(" (", 1)[0]
            traces.append(
                Trace(
                    names[k],
                    cell("SymbolName", k),
                    start,
                    k,
                    "" if unit == "(None)" else unit,
                    cell("SampleTime[ms]", k),
                    {word: value for word in _SCALES if (value := cell(word, k))},
                )
            )
    return tuple(traces)


def _cells(line: bytes, separator: str) -> list[str]:
    text = as_text(line)
    try:
        fields = next(csv.reader([text], delimiter=separator), [])
    except csv.Error:
        fields = text.split(separator)
    return [field.strip() for field in fields] or [""]


def _without_empty_end(cells: list[str]) -> list[str]:
    while len(cells) > 1 and not cells[-1]:
        cells = cells[:-1]
    return cells
