"""Reads text exports of TwinCAT Scope (`twincat.py`) in blocks of lines."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from deltaid.errors import Doubt, RecordingError
from deltaid.recording.formats.csv_lines import (
    NO_LINE_BREAK,
    Decimals,
    TextData,
    line_ends,
    per_line,
)
from deltaid.recording.source import LogTable, Rows
from deltaid.recording.time.signals import Signal, merged

# Name of the time, which the export does not name.
TIME = "t"
# Factors and offsets that change nothing.
NEUTRAL = {"ScaleFactor": 1.0, "Offset": 0.0, "Unit ScaleFactor": 1.0, "Unit Offset": 0.0}


@dataclass(frozen=True)
class ScopeChannel:
    """A channel of an export: names, columns, unit and scales.

    Attributes:
        name, symbol: name of the channel, and its symbol in the PLC.
        time, values: indices of its columns of times and values.
        unit: unit of its values; empty if none is stated.
        scales: stated factors and offsets of the channel and of its unit.
    """

    name: str
    symbol: str
    time: int
    values: int
    unit: str
    scales: dict[str, str]


@dataclass(frozen=True)
class ScopeTable(LogTable):
    """An open export of TwinCAT Scope.

    If all used channels share their times, one block of lines is in memory at a time, otherwise
    these channels as a whole.

    Attributes:
        data: lines of data below the rows about channels.
        columns: number of columns, times included.
        ends_on_separator: whether lines have a separator after their last field.
        origin: first time, if times are in 100 ns since 1601; None if they are in ms since the
            first sample.
        channels: channels in order.
        traces: channels by name, and by symbol if that differs.
        shared: whether columns of times are equal, by the indices of columns that were compared.
    """

    data: TextData
    columns: int
    ends_on_separator: bool
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

    def row_name(self, row: int) -> str:
        """Place of a row, for messages: a line, or a sample if a line is not one instant."""
        if all(self.shared.values()):
            return super().row_name(row)
        return f"sample {row - self.first_row + 1}"

    def rows(self, columns: Sequence[str]) -> Iterator[Rows]:
        """Read as in `LogTable.rows`; the time is in s since the first sample."""
        names = [pick.field.name for pick in self.picks(columns)]
        used = [self.traces[name] for name in names if name != TIME]
        times = tuple(sorted({trace.time for trace in used or self.channels[:1]}))
        scaled = [doubt for trace in used for doubt in _scaled(trace)]
        self.doubts[:] = scaled + [NO_LINE_BREAK] * self.data.ends_open
        if times not in self.shared:
            self.shared[times] = self._share(times)
        groups = {k: [trace.values for trace in used if trace.time == k] for k in times}
        at = [times[0] if name == TIME else self.traces[name].values for name in names]
        if not self.shared[times]:
            yield self._merged(at, groups)
            return
        decimals = Decimals(self.data.separator)
        for _, frame in self._blocks([*groups, *at]):
            there = [_filled(frame, [time, *values]) for time, values in groups.items()]
            frame = frame.filter(np.logical_and.reduce(there))
            texts = [frame[str(k)] for k in at]
            numbers = [
                self._seconds(text, series) if k in groups else series
                for k, text, series in zip(at, texts, decimals.numbers(texts), strict=True)
            ]
            yield Rows(numbers, texts)

    def _share(self, times: Sequence[int]) -> bool:
        """Whether columns of times are equal, line by line, until one of them ends."""
        if len(times) == 1:
            return True
        lines: list[np.ndarray] = []
        for _, frame in self._blocks(times):
            texts = [frame[str(k)] for k in times]
            filled = np.column_stack([(text != "").to_numpy() for text in texts])
            equal = np.column_stack([(text == texts[0]).to_numpy() for text in texts])
            lines.append(np.column_stack([filled.all(1), filled.any(1), equal.all(1)]))
        whole, part, equal = np.vstack(lines).T
        until = np.flatnonzero(whole)[-1] if whole.any() else 0
        return not (whole & ~equal).any() and not (part & ~whole)[:until].any()

    def _merged(self, at: list[int], groups: dict[int, list[int]]) -> Rows:
        columns = [k for time, values in groups.items() for k in (time, *values)]
        decimals = Decimals(self.data.separator)
        parts: dict[int, list[Signal]] = {time: [] for time in groups}
        for row, frame in self._blocks(columns):
            # The first decimal mark in any column applies to all.
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
                cure="no action is needed if all were of one controller; one task for all of "
                "them keeps them in step",
            )
        )
        order = [k for group in groups.values() for k in group]
        values_of = dict(zip(order, signal.values.T, strict=True))
        numbers = [signal.time if k in groups else values_of[k] for k in at]
        return Rows(numbers, numbers)

    def _seconds(self, text: pl.Series, numbers: pl.Series) -> np.ndarray:
        if self.origin is not None:
            ticks = text.cast(pl.Int64, strict=False) - self.origin
            return ticks.cast(pl.Float64).to_numpy() / 1e7
        return numbers.to_numpy() / 1e3

    def _blocks(self, columns: Sequence[int]) -> Iterator[tuple[int, pl.DataFrame]]:
        """Columns as text, with the row of the first line; empty fields are empty text."""
        row = self.first_row
        names = [str(k) for k in dict.fromkeys(columns)]
        # The first line determines the number of columns for polars.
        above = (self.data.separator * (self.columns - 1)).encode() + b"\n"
        for block in self.data.blocks():
            self._require_fields(block, row)
            frame = pl.read_csv(
                io.BytesIO(above + block),
                has_header=False,
                separator=self.data.separator,
                schema={str(k): pl.String for k in range(self.columns)},
                truncate_ragged_lines=True,
                quote_char=None,
                encoding="utf8-lossy",
            )
            frame = frame[1:].select(pl.col(names).str.strip_chars().fill_null(""))
            yield row, frame
            row += frame.height

    def _require_fields(self, block: bytes, row: int) -> None:
        """Refuse lines with more fields than columns."""
        ends = line_ends(block)
        marks = np.flatnonzero(np.frombuffer(block, np.uint8) == ord(self.data.separator))
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

    def _named(self, column: int) -> str:
        return next((trace.name for trace in self.channels if trace.values == column), TIME)


def _filled(frame: pl.DataFrame, columns: Sequence[int]) -> np.ndarray:
    return np.logical_or.reduce([(frame[str(k)] != "").to_numpy() for k in columns])


def _scaled(trace: ScopeChannel) -> list[Doubt]:
    scales = {word: _number(trace.scales.get(word), usual) for word, usual in NEUTRAL.items()}
    stated = [f"{word} {x:g}" for word, x in scales.items() if x != NEUTRAL[word]]
    if not stated:
        return []
    factor, offset = scales["ScaleFactor"], scales["Offset"]
    how = "change unit and zero of its column accordingly"
    if factor and not any(word.startswith("Unit") for word in stated):
        sign = ", sign: -1" * (factor < 0)
        unit = f"{abs(factor):g} {trace.unit or 'UNIT'}"
        how = f"declare {{unit: {unit}, zero: {0 - offset / factor:g}{sign}}}"
    return [
        Doubt(
            f"channel {trace.name} is scaled in Scope ({', '.join(stated)}); the file does not say "
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
