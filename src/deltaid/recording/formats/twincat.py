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
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError, visible
from deltaid.recording.address import RecordedField
from deltaid.recording.formats.csv_lines import (
    NO_LINE_BREAK,
    Decimals,
    HeadLines,
    as_text,
    find_end,
    is_number,
    line_ends,
    per_line,
    whole_lines,
)
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.source import LogTable, Rows, content
from deltaid.recording.time.segments import Signal, merged

# The name of the time, which the export has under none of its own.
TIME = "t"
# What scales nothing.
_NEUTRAL = {"ScaleFactor": 1.0, "Offset": 0.0, "Unit ScaleFactor": 1.0, "Unit Offset": 0.0}
# Lines in which the first data is looked for, and of data that show how many columns there are.
_SEARCHED_LINES, _SHOWING_LINES = 500, 50
_NAMES = ("Name", "SymbolName")
_WORDS = {*_NAMES, *_NEUTRAL, "Unit"}
_FIRST = re.compile(rb'\A(?:\xef\xbb\xbf)?"?Name"?(?P<separator>[^\w"\r\n])')
# Words that stand at the head of a line of such a file and hardly of another.
_MARKS = re.compile(
    rb'\n"?(?:File|Starttime of export|StartRecord|SymbolName|SymbolComment|Data-Type|NetI[dD]|'
    rb'SampleTime\[ms\]|IndexGroup)"?[^\w"\r\n]'
)
# Times as Windows counts them, in 100 ns since 1601, are beyond this; in ms they never are.
_FILE_TIME = 1e16


@dataclass(frozen=True)
class ScopeChannel:
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
    scales: dict[str, str]


@dataclass(frozen=True)
class ScopeTable(LogTable):
    """An open export.

    Where all channels in use share their times, a block of lines is in memory at a time; otherwise
    these channels are, as a whole.

    Attributes:
        separator: between fields.
        columns: how many there are, times included.
        ends_on_separator: whether lines have a separator after their last field.
        data_start, data_size: where the data starts, and how much there is [bytes].
        ends_open: whether the file ends without a line break.
        origin: the first time of all, where times are in 100 ns since 1601; None where they are in
            ms since the first sample.
        channels: in order.
        traces: channels by name, and by symbol where that is another one.
        shared: whether channels of some columns of times share them, as far as looked at.
    """

    separator: str
    columns: int
    ends_on_separator: bool
    data_start: int
    data_size: int
    ends_open: bool
    origin: int | None
    channels: tuple[ScopeChannel, ...]
    traces: dict[str, ScopeChannel]
    shared: dict[tuple[int, ...], bool] = field(
        default_factory=dict[tuple[int, ...], bool], compare=False
    )
    cure_of_missing: str = field(
        default="say with --columns MAPPING.yaml which channel is what, by its name or its symbol; "
        f"the time is {TIME}, in s, whatever the export counts in",
        kw_only=True,
    )

    def row_place(self, row: int) -> str:
        """One row, for messages: a line, or where lines are no instants a sample."""
        if all(self.shared.values()):
            return f"{self.path}, row {row}"
        return f"{self.path}, sample {row - self.first_row + 1}"

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """As in `LogTable.rows`; the time is in s since the first sample."""
        names = [pick.field.name for pick in self.picks(columns)]
        used = [self.traces[name] for name in names if name != TIME]
        times = tuple(sorted({trace.time for trace in used or self.channels[:1]}))
        self.doubts[:] = [said for trace in used for said in _scaled(trace)]
        if self.ends_open:
            self.doubts.append(NO_LINE_BREAK)
        if times not in self.shared:
            self.shared[times] = self._share(times)
        groups = {k: [trace.values for trace in used if trace.time == k] for k in times}
        at = [times[0] if name == TIME else self.traces[name].values for name in names]
        if self.shared[times]:
            yield from self._streamed(at, groups)
        else:
            yield self._merged(at, groups)

    def _share(self, times: Sequence[int]) -> bool:
        """Whether some columns of times are the same, line by line, until one of them ends."""
        if len(times) == 1:
            return True
        lines: list[np.ndarray] = []
        for _, frame in self._blocks(times):
            texts = [frame[str(k)] for k in times]
            filled = np.column_stack([(text != "").to_numpy() for text in texts])
            equal = np.column_stack([(text == texts[0]).to_numpy() for text in texts])
            lines.append(np.column_stack([filled.all(1), filled.any(1), equal.all(1)]))
        whole, some, equal = np.vstack(lines).T
        until = np.flatnonzero(whole)[-1] if whole.any() else 0
        return not (whole & ~equal).any() and not (some & ~whole)[:until].any()

    def _streamed(self, at: list[int], groups: dict[int, list[int]]) -> Iterator[Rows]:
        decimals = Decimals(self.separator)
        for _, frame in self._blocks([*groups, *at]):
            there = [_filled(frame, [time, *values]) for time, values in groups.items()]
            frame = frame.filter(np.logical_and.reduce(there))
            texts = [frame[str(k)] for k in at]
            numbers = [
                self._seconds(text, series) if k in groups else series
                for k, text, series in zip(at, texts, decimals.numbers(texts), strict=True)
            ]
            yield Rows(numbers, texts)

    def _merged(self, at: list[int], groups: dict[int, list[int]]) -> Rows:
        columns = [k for time, values in groups.items() for k in (time, *values)]
        decimals = Decimals(self.separator)
        parts: dict[int, list[Signal]] = {time: [] for time in groups}
        for row, frame in self._blocks(columns):
            # Whichever column has a decimal mark first, it holds for all.
            decimals.numbers([frame[str(k)] for k in columns])
            for time, values in groups.items():
                there = np.flatnonzero(_filled(frame, [time, *values]))
                texts = [frame[str(k)].gather(there) for k in (time, *values)]
                numbers = decimals.numbers(texts)
                block = np.column_stack([self._seconds(texts[0], numbers[0]), *numbers[1:]])
                bad = np.argwhere(~np.isfinite(block))
                if bad.size:
                    i, k = (int(index) for index in bad[0])
                    place = f"{self.path}, row {row + int(there[i])}"
                    raise self.bad_value(self._named((time, *values)[k]), texts[k][i], place)
                parts[time].append(Signal(block[:, 0], block[:, 1:]))
        named = [f"channel {self._named(values[0])}" for values in groups.values()]
        signal, same = merged(named, parts.values(), str(self.path))
        instants = [
            self._named(k)
            for is_same, group in zip(same, groups.values(), strict=True)
            for k in group
            if is_same
        ]
        self.doubts.append(
            Doubt(
                "channels in use have times of their own; they are interpolated to those of "
                f"{', '.join(instants)}",
                cause="they are recorded in tasks of different cycles",
                cure="nothing is to be done if all were of one controller; one task for all of "
                "them keeps them in step",
            )
        )
        order = [k for group in groups.values() for k in group]
        found = dict(zip(order, signal.values.T, strict=True))
        numbers = [signal.time if k in groups else found[k] for k in at]
        return Rows(numbers, numbers)

    def _seconds(self, text: pl.Series, numbers: pl.Series) -> np.ndarray:
        if self.origin is not None:
            ticks = text.cast(pl.Int64, strict=False) - self.origin
            return ticks.cast(pl.Float64).to_numpy() / 1e7
        return numbers.to_numpy() / 1e3

    def _blocks(self, columns: Sequence[int]) -> Iterator[tuple[int, pl.DataFrame]]:
        """Some columns as text, empty where there is none, with the row of the first line."""
        row = self.first_row
        names = [str(k) for k in dict.fromkeys(columns)]
        # polars takes the number of columns from the first line.
        above = (self.separator * (self.columns - 1)).encode() + b"\n"
        for block in whole_lines(self.path, self.data_start, self.data_size):
            lines = self._require_fields(block, row)
            frame = pl.read_csv(
                io.BytesIO(above + block),
                has_header=False,
                separator=self.separator,
                schema={str(k): pl.String for k in range(self.columns)},
                truncate_ragged_lines=True,
                quote_char=None,
                encoding="utf8-lossy",
            )
            frame = frame[1:].select(pl.col(names).str.strip_chars().fill_null(""))
            if frame.height != lines:
                last = row + lines - 1
                raise RecordingError(
                    "are not lines of an export of TwinCAT Scope",
                    where=f"{self.path}, rows {row} to {last}",
                    cure="export it again",
                )
            yield row, frame
            row += lines

    def _require_fields(self, block: bytes, row: int) -> int:
        """The number of lines of a block, none with more fields than there are columns."""
        ends = line_ends(block)
        marks = np.flatnonzero(np.frombuffer(block, np.uint8) == ord(self.separator))
        fields = per_line(marks, ends) + 1
        long = np.flatnonzero(fields > self.columns + self.ends_on_separator)
        if long.size:
            i = int(long[0])
            raise RecordingError(
                f"has {fields[i]} fields, but the header has {self.columns}",
                where=f"{self.path}, row {row + i}",
                cure="export it again with tabs or semicolons between the columns; decimal commas "
                "do not go with commas between them",
            )
        return len(ends)

    def _named(self, column: int) -> str:
        found = [trace.name for trace in self.channels if trace.values == column]
        return found[0] if found else TIME


def _filled(frame: pl.DataFrame, columns: Sequence[int]) -> np.ndarray:
    return np.logical_or.reduce([(frame[str(k)] != "").to_numpy() for k in columns])


def _scaled(trace: ScopeChannel) -> list[Doubt]:
    scales = {word: _number(trace.scales.get(word), usual) for word, usual in _NEUTRAL.items()}
    said = [f"{word} {scales[word]:g}" for word, usual in _NEUTRAL.items() if scales[word] != usual]
    if not said:
        return []
    factor, offset = scales["ScaleFactor"], scales["Offset"]
    how = "change unit and zero of its column accordingly"
    if factor and not any(word.startswith("Unit") for word in said):
        sign = ", sign: -1" * (factor < 0)
        unit = f"{abs(factor):g} {trace.unit or 'UNIT'}"
        how = f"declare {{unit: {unit}, zero: {0 - offset / factor:g}{sign}}}"
    return [
        Doubt(
            f"channel {trace.name} is scaled in Scope ({', '.join(said)}); the file does not say "
            "whether its numbers are, and they are taken as they stand",
            cause="an export scales them only with the option Scale values before export",
            cure=f"if they are those of the PLC, {how}",
        )
    ]


def _number(text: str | None, otherwise: float) -> float:
    try:
        return float((text or "").replace(",", "."))
    except ValueError:
        return otherwise


def is_scope(start: bytes, path: Path) -> bool:
    """Whether a file is an export, by the words at the head of its first lines."""
    first = _FIRST.match(start)
    if not first:
        return False
    line, separator = start.split(b"\n", 1)[0], first["separator"]
    return bool(_MARKS.search(start)) or separator + b"Name" + separator in line


def open_scope(path: Path, mapping: ColumnMapping) -> LogTable:
    """Find out how an export is laid out.

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
            cure="export with a header and with times (Timelines: All, or For each "
            "sampletime), separated by tabs or semicolons: names may hold blanks, and numbers "
            "commas",
        )
    with content(path) as file:
        data_size, _, last_byte = find_end(file, data_start, separator)
    times = [shown[0][k] for k in heads if k < len(shown[0]) and shown[0][k].isdecimal()]
    origin = min(map(int, times), default=0)
    channels = tuple(_channels(rows, names, heads))
    traces = {trace.name: trace for trace in reversed(channels) if trace.name}
    symbols = [trace.symbol for trace in channels]
    for trace in channels:
        if symbols.count(trace.symbol) == 1 and trace.symbol and trace.symbol not in traces:
            traces[trace.symbol] = trace
    named = [trace.name for trace in channels if trace.name]
    more = [name for name in traces if name not in named]
    return ScopeTable(
        path,
        (RecordedField(TIME), *map(RecordedField, named), *map(RecordedField, more)),
        separator,
        len(names),
        ends_on_separator,
        data_start,
        data_size,
        not last_byte.endswith(b"\n"),
        origin if origin > _FILE_TIME else None,
        channels,
        traces,
        first_row=first_row,
        units={name: trace.unit for name, trace in traces.items() if trace.unit},
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
                {word: value for word in _NEUTRAL if (value := cell(word, k))},
            )


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
