"""The column that names the parts of a file in which several recordings stand one below another."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from deltaid.errors import RecordingError, quoted, visible
from deltaid.recording.source import LogTable


@dataclass(frozen=True)
class PartColumn:
    """A column that has one value in each part.

    Attributes:
        name: of the column.
        before, after: its values in the rows before and after its first change.
    """

    name: str
    before: str
    after: str


def part_column(table: LogTable, time: str, starts: Collection[int]) -> PartColumn | None:
    """The first column that changes in no row but where time starts again; None without one.

    Args:
        time: column of the time.
        starts: rows in which time starts again, from 0.

    Raises:
        RecordingError: the recording cannot be read.
    """
    names = list(_candidates(table, time))
    steady, parts = set(names), dict[str, PartColumn]()
    last, row = dict[str, np.ndarray](), 0
    for block in table.rows([time, *names]) if names else ():
        for name, written in zip(names, map(np.asarray, block.written[1:]), strict=True):
            if name not in steady:
                continue
            values = np.concatenate([last[name], written]) if name in last else written
            changes = np.flatnonzero(values[1:] != values[:-1]) + 1
            rows = changes + row - (len(values) - len(written))
            if not np.isin(rows, list(starts)).all():
                steady.remove(name)
            elif changes.size and name not in parts:
                before, after = values[changes[0] - 1 : changes[0] + 1].tolist()
                parts[name] = PartColumn(name, _shown(before), _shown(after))
            last[name] = values[-1:]
        if not steady:
            break
        row += block.size
    return next((parts[name] for name in names if name in steady & {*parts}), None)


def _candidates(table: LogTable, time: str) -> Iterator[str]:
    """Columns of one value a row that may be read beside the time."""
    for entry in table.fields:
        if entry.name != time and len(entry.shape) == 1 and not entry.holds:
            with suppress(RecordingError):
                table.picks([time, entry.name])
                yield entry.name


def _shown(value: object) -> str:
    return quoted(visible(f"{value:g}" if isinstance(value, float) else str(value), kept=""))
