"""Previews of recordings: raw rows, and models together with measurements.

They run in a separate process; arguments and results are plain data.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.verdicts import mapping_text
from deltaid.dynamics.dynamics import compiled
from deltaid.identification.loads import as_identified
from deltaid.identification.torque_error import torque_error
from deltaid.model.model import load
from deltaid.recording.columns import Channel
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.opening import open_log, resolved_table
from deltaid.recording.source import LogTable
from deltaid.recording.table import open_table
from deltaid.robot.load import load_robot, parse, yaml_text
from deltaid.studio.folder import stamp
from deltaid.view.comparison import (
    POINTS,
    TorqueComparison,
    compare,
    extreme_rows,
    stretch_length,
)

# Number of cached previews and comparisons.
REMEMBERED = 40
# Rows of a block of long curves that is first reduced to its two extremes, to save memory.
_BLOCK = 128


@dataclass(frozen=True)
class Curve:
    """One column over time, thinned so that no peak is lost.

    Attributes:
        name: of the column.
        quantity, drive: that it records, with drives counted from 0.
        unit: of the values.
        model: index of the model that predicts it among the requested ones; None for measurements.
    """

    name: str
    quantity: str
    drive: int
    unit: str
    time: Float[np.ndarray, " points"]
    values: Float[np.ndarray, " points"]
    model: int | None = None


@dataclass(frozen=True)
class Preview:
    """A recording as a mapping interprets it."""

    curves: tuple[Curve, ...]
    rows: int
    seconds: float


def preview(path: str, robot: str, mapping: dict[str, Any], span: Any = None) -> Preview:
    """A recording as a mapping interprets it: positions in degrees or m, torques in N m or N.

    Args:
        path: the recording.
        robot: name or file.
        mapping: data of a mapping file.
        span: first and last second to show; None for all.

    Raises:
        RecordingError: a column is missing, or the file cannot be read.
    """
    given = parse(yaml_text(mapping), ColumnMapping, where="mapping") if mapping else None
    description = load_robot(robot)
    table, columns, _ = resolved_table(Path(path), compiled(description).kinematics, given)
    curves = [
        (quantity, drive, channel)
        for quantity in ("position", "velocity", "torque")
        for drive, channel in enumerate(getattr(columns, quantity))
    ]
    names = [channel.column for _, _, channel in curves]
    time = None if columns.time.is_absent else columns.time.column
    thinned = _thinned(table, time, names, span, columns.time)
    drawn: list[Curve] = []
    for k, (quantity, drive, channel) in enumerate(curves):
        units = description.units(description.drives[drive])
        time, values = thinned.curve(k)
        scale = 1.0 if quantity == "torque" else units.per_shown
        unit = {"torque": units.force, "position": units.shown}.get(quantity, f"{units.shown}/s")
        values = scale * _si(channel, values)
        drawn.append(Curve(channel.column, quantity, drive, unit, time, values))
    return Preview(tuple(drawn), thinned.rows, thinned.seconds)


def signals(path: str, time: str | None, columns: Sequence[str], span: Any = None) -> Preview:
    """Columns of a recording before they are mapped, over time or over rows.

    Args:
        path: the recording.
        time: column of the time, in its own unit; None for the row number.
        columns: to be drawn; those whose names differ in numbers only share a panel.
        span: as of `preview`, in the unit of the time.

    Raises:
        RecordingError: a column is missing, or the file cannot be read.
    """
    thinned = _thinned(open_table(Path(path)), time, columns, span)
    stems = [re.sub(r"\d+", "…", name) for name in columns]
    drawn = [
        Curve(name, stem, stems[:k].count(stem), "", *thinned.curve(k))
        for k, (name, stem) in enumerate(zip(columns, stems, strict=True))
    ]
    return Preview(tuple(drawn), thinned.rows, thinned.seconds)


def _thinned(
    table: LogTable, time: str | None, names: Sequence[str], span: Any,
    channel: Channel | None = None,
) -> "MinMax":  # fmt: skip
    """Thinned curves of columns over a time column, which a channel converts, or over rows."""
    thinned = MinMax(len(names), POINTS, span)
    for rows in table.rows(names if time is None else [time, *names]):
        numbers = [np.asarray(column, dtype=float) for column in rows.numbers]
        own = np.arange(thinned.rows, thinned.rows + len(numbers[0]), dtype=float)
        if time is not None:
            own = numbers.pop(0)
        thinned.add(own if channel is None else _si(channel, own), np.column_stack(numbers))
    return thinned


def mapping_cured(
    path: str, robot: str, mapping: str | None, wanted: Sequence[tuple[str, object]]
) -> str:
    """The text of a mapping file with changes that a verdict proposes.

    Raises:
        DeltaidError: robot, recording or mapping is invalid.
    """
    record = evidence(load_robot(robot), Path(path), load_mapping(mapping) if mapping else None)
    return mapping_text(record, dict(wanted))


@dataclass(frozen=True)
class TorqueCurves:
    """Predictions of models for a recording.

    Attributes:
        drives: their names.
        curves: torques, and errors, which are predicted minus measured torques [N m or N].
        nrmse: normalised error of each model and drive.
    """

    drives: tuple[str, ...]
    curves: tuple[Curve, ...]
    nrmse: Float[np.ndarray, "models drives"]


def torques(
    path: str,
    mapping: str | None,
    models: Sequence[str],
    span: tuple[float, float] | None = None,
) -> TorqueCurves:
    """Measured torques of a recording, and predictions of models.

    Args:
        path, mapping, models: files.
        span: first and last second to show; None for all.

    Raises:
        DeltaidError: recording, mapping or a model is invalid, or they belong to different robots.
    """
    changed = tuple(stamp(Path(name)) for name in (path, mapping, *models) if name)
    compared = [_compared(path, mapping, model, changed) for model in models]
    robot = load(models[0]).robot
    units = [robot.units(drive).force for drive in robot.drives]

    def thinned(quantity: str, model: int | None, values: np.ndarray) -> list[Curve]:
        thin = MinMax(len(units), POINTS, span)
        thin.add(compared[model or 0][0].time, values)
        return [
            Curve(drive, quantity, k, units[k], *thin.curve(k), model)
            for k, drive in enumerate(robot.drives)
        ]

    curves = thinned("torques", None, compared[0][0].measured)
    for k, (comparison, _) in enumerate(compared):
        curves += thinned("torques", k, comparison.predicted)
        curves += thinned("errors", k, comparison.predicted - comparison.measured)
    nrmse = np.array([nrmse for _, nrmse in compared])
    return TorqueCurves(tuple(robot.drives), tuple(curves), nrmse)


@lru_cache(REMEMBERED)
def _compared(
    path: str, mapping: str | None, name: str, _changed: tuple[object, ...]
) -> tuple[TorqueComparison, Float[np.ndarray, " drives"]]:
    model = load(name)
    log = open_log(path, model.dynamics.kinematics, load_mapping(mapping) if mapping else None)
    recording = as_identified(model, log)
    nrmse = torque_error(model.dynamics, model.p, recording).nrmse
    return compare(model.dynamics, model.p, recording), nrmse


def _si(channel: Channel, values: np.ndarray) -> np.ndarray:
    return channel.scale * (values - channel.zero)


class MinMax:
    """Curves of any length, reduced to minimum and maximum of each stretch.

    Rows come in blocks; a sixty-fourth of them is kept in memory, or all of short curves.

    Args:
        curves: number of curves.
        points: largest number of points of each result.
        span: first and last time that count; None for all.
    """

    def __init__(self, curves: int, points: int, span: Any = None) -> None:
        self.rows, self._taken = 0, 0
        self._points, self._span = max(4, points), span
        self._kept: list[list[np.ndarray]] = [[np.empty((2, 0))] for _ in range(curves)]
        self._ends: list[float] = []

    @property
    def seconds(self) -> float:
        """Duration from the first to the last time."""
        return float(max(self._ends[-1] - self._ends[0], 0.0)) if self._ends else 0.0

    def add(self, time: Float[np.ndarray, " rows"], values: Float[np.ndarray, "rows _"]) -> None:
        """Add consecutive rows of all curves."""
        self.rows += len(time)
        self._ends += time[[0, -1]].tolist() if len(time) else []
        if self._span is not None:
            inside = (time >= self._span[0]) & (time <= self._span[1])
            time, values = time[inside], values[inside]
        self._taken += len(time)
        for parts, column in zip(self._kept, values.T, strict=True):
            rows = extreme_rows(column, _BLOCK) if self._taken > 8 * self._points else slice(None)
            parts.append(np.stack([time[rows], column[rows]]))

    def curve(self, k: int) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """Times and values of one curve."""
        time, values = np.concatenate(self._kept[k], axis=1)
        if len(time) > self._points:
            kept = extreme_rows(values, stretch_length(2 * len(time), self._points))
            time, values = time[kept], values[kept]
        return time, values
