"""Looks at a recording, made in a process of their own: what it holds, and a preview of its rows.

What goes in and out is plain data. An error of the program is a value here, a `Problem`.
"""

import importlib
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.verdicts import mapping_text
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.recording.columns import Channel
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.opening import resolved_table
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table
from deltaid.robot.load import described, parse, yaml_text
from deltaid.view.comparison import extreme_rows, stretch_length

# Points of a curve at most; a screen has hardly more columns.
POINTS = 1600

# Rows of a block of which two are kept at first; a picture has fewer points than blocks.
_BLOCK = 128

_Asked = ParamSpec("_Asked")
_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Problem:
    """An error of the program, on its way between processes and onto a page.

    Attributes:
        passes: whether it may be gone the next time.
    """

    what: str
    where: str = ""
    cure: str = ""
    passes: bool = False

    @staticmethod
    def from_error(error: DeltaidError) -> "Problem":
        """The same error as data."""
        return Problem(error.what, error.where, error.cure)

    def inside(self, folder: Path) -> "Problem":
        """The same with files of a folder called by their names there."""
        return replace(self, where=self.where.replace(f"{folder}{os.sep}", ""))


@dataclass(frozen=True)
class Curve:
    """One column over time, thinned so that no peak is lost.

    Attributes:
        name, quantity, drive: of the column, and what it is of which drive, counted from 0.
        unit: of the values.
    """

    name: str
    quantity: str
    drive: int
    unit: str
    time: Float[np.ndarray, " points"]
    values: Float[np.ndarray, " points"]


@dataclass(frozen=True)
class Preview:
    """What a mapping makes of a recording."""

    curves: tuple[Curve, ...]
    rows: int
    seconds: float


def try_look(
    look: Callable[_Asked, _Found], *given: _Asked.args, **named: _Asked.kwargs
) -> _Found | Problem:
    """A look, or the error that the program has about it."""
    try:
        return look(*given, **named)
    except DeltaidError as error:
        return Problem.from_error(error)


def ready() -> bool:
    """Load what other looks need, so that the first one is quick too."""
    for name in ("deltaid.view.reach", "deltaid.view.comparison"):
        importlib.import_module(name)
    return True


def preview(
    path: str, robot: str, mapping: dict[str, Any], points: int = POINTS, span: Any = None
) -> Preview:
    """A recording as a mapping reads it: positions in degrees or m, torques in N m or N.

    Args:
        path: the recording.
        robot: name or file.
        mapping: data of a mapping file.
        points: at most so many on each curve.
        span: first and last second to be shown; None for all.

    Raises:
        RecordingError: a column is missing, or the file cannot be read.
    """
    given = parse(yaml_text(mapping), ColumnMapping, where="mapping") if mapping else None
    description = described(robot)
    table, columns, _ = resolved_table(Path(path), compiled(description).kinematics, given)
    curves = [
        (quantity, drive, channel)
        for quantity in ("position", "velocity", "torque")
        for drive, channel in enumerate(getattr(columns, quantity))
    ]
    names = [channel.column for _, _, channel in curves]
    time = None if columns.time.is_absent else columns.time.column
    seen = _thinned(table, time, names, points, span, columns.time)
    drawn: list[Curve] = []
    for k, (quantity, drive, channel) in enumerate(curves):
        units = description.units(description.drives[drive])
        time, values = seen.curve(k)
        scale = 1.0 if quantity == "torque" else units.per_shown
        unit = {"torque": units.force, "position": units.shown}.get(quantity, f"{units.shown}/s")
        values = scale * _si(channel, values)
        drawn.append(Curve(channel.column, quantity, drive, unit, time, values))
    return Preview(tuple(drawn), seen.rows, seen.seconds)


def signals(
    path: str, time: str | None, columns: Sequence[str], points: int = POINTS, span: Any = None
) -> Preview:
    """Columns of a recording as they are, before they are mapped: over time, or over rows.

    Args:
        path: the recording.
        time: column of the time, in its own unit; None for the number of the row.
        columns: to be drawn; those whose names differ in numbers only share a row of curves.
        points, span: as of `preview`, in the unit of the time.

    Raises:
        RecordingError: a column is missing, or the file cannot be read.
    """
    seen = _thinned(open_table(Path(path)), time, columns, points, span)
    rows = dict[str, int]()
    drawn = list[Curve]()
    for k, name in enumerate(columns):
        stem = re.sub(r"\d+", "…", name)
        rows[stem] = rows.get(stem, -1) + 1
        drawn.append(Curve(name, stem, rows[stem], "", *seen.curve(k)))
    return Preview(tuple(drawn), seen.rows, seen.seconds)


def _thinned(
    table: LogTable, time: str | None, names: Sequence[str], points: int, span: Any,
    channel: Channel | None = None,
) -> "MinMax":  # fmt: skip
    """Thinned curves of columns over a column of time, which a channel converts, or over rows."""
    seen = MinMax(len(names), points, span)
    for rows in table.rows(names if time is None else [time, *names]):
        numbers = [np.asarray(column, dtype=float) for column in rows.numbers]
        own = np.arange(seen.rows, seen.rows + len(numbers[0]), dtype=float)
        if time is not None:
            own = numbers.pop(0)
        seen.add(own if channel is None else _si(channel, own), np.column_stack(numbers))
    return seen


def mapping_cured(
    path: str, robot: str, mapping: str | None, wanted: Sequence[tuple[str, object]]
) -> str:
    """The text of a mapping file with changes that a verdict proposes.

    Raises:
        DeltaidError: robot, recording or mapping cannot be read.
    """
    record = evidence(described(robot), Path(path), load_mapping(mapping) if mapping else None)
    return mapping_text(record, dict(wanted), Path(mapping) if mapping else None)


def _si(channel: Channel, values: np.ndarray) -> np.ndarray:
    return channel.scale * (values - channel.zero)


class MinMax:
    """Curves of any length, of which two points a stretch are kept: its smallest and its largest.

    Rows come in pieces; memory is a sixty-fourth of what has come, or all of short curves.

    Args:
        curves: how many.
        points: at most so many are left of each.
        span: first and last time that count; None for all.
    """

    def __init__(self, curves: int, points: int, span: Any = None) -> None:
        self.rows, self._taken = 0, 0
        self._points, self._span = max(4, points), span
        self._values: list[list[np.ndarray]] = [[] for _ in range(curves)]
        self._places: list[list[np.ndarray]] = [[] for _ in range(curves)]
        self._first, self._last = np.inf, -np.inf

    @property
    def seconds(self) -> float:
        """From the first to the last time."""
        return float(max(self._last - self._first, 0.0))

    def add(self, time: Float[np.ndarray, " rows"], values: Float[np.ndarray, "rows _"]) -> None:
        """Take a piece of rows."""
        self.rows += len(time)
        if len(time):
            self._first = min(self._first, float(time[0]))
            self._last = max(self._last, float(time[-1]))
        if self._span is not None:
            inside = (time >= self._span[0]) & (time <= self._span[1])
            time, values = time[inside], values[inside]
        self._taken += len(time)
        for k, column in enumerate(values.T):
            kept = (
                extreme_rows(column, _BLOCK)
                if self._taken > 8 * self._points
                else np.arange(len(time))
            )
            self._places[k].append(time[kept])
            self._values[k].append(column[kept])

    def curve(self, k: int) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """Times and values of one curve."""
        if not self._values[k]:
            return np.empty(0), np.empty(0)
        time, values = np.concatenate(self._places[k]), np.concatenate(self._values[k])
        if len(time) > self._points:
            kept = extreme_rows(values, stretch_length(2 * len(time), self._points))
            time, values = time[kept], values[kept]
        return time, values
