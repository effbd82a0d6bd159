"""Looks at a recording, made in a process of their own: what it holds, and a preview of its rows.

What goes in and out is plain data. An error of the program is a value here, a `Problem`.
"""

import importlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float

from deltaid.checks.evidence import evidence
from deltaid.checks.verdicts import mended
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.recording.columns import Channel
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.opening import resolved_table
from deltaid.robot.load import described, parse, yaml_text
from deltaid.studio.decimate import MinMax

# Points of a curve at most; a screen has hardly more columns.
POINTS = 1600

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
    asked = names if columns.time.is_absent else [columns.time.column, *names]
    seen = MinMax(len(curves), points, span)
    for rows in table.rows(asked):
        numbers = np.column_stack([np.asarray(column, dtype=float) for column in rows.numbers])
        counted = np.arange(seen.rows, seen.rows + len(numbers), dtype=float)
        own = counted if columns.time.is_absent else numbers[:, 0]
        seen.add(_si(columns.time, own), numbers[:, 0 if columns.time.is_absent else 1 :])
    drawn: list[Curve] = []
    for k, (quantity, drive, channel) in enumerate(curves):
        units = description.units(description.drives[drive])
        time, values = seen.curve(k)
        scale, unit = _shown(quantity, units.per_shown, units.shown, units.force)
        values = scale * _si(channel, values)
        drawn.append(Curve(channel.column, quantity, drive, unit, time, values))
    return Preview(tuple(drawn), seen.rows, seen.seconds)


def mapping_cured(
    path: str, robot: str, mapping: str | None, wanted: Sequence[tuple[str, object]]
) -> str:
    """The text of a mapping file with changes that a verdict proposes.

    Raises:
        DeltaidError: robot, recording or mapping cannot be read.
    """
    given = load_mapping(mapping) if mapping else None
    record = evidence(described(robot), Path(path), given)
    return yaml_text(mended(record.written_mapping, dict(wanted)))


def _si(channel: Channel, values: np.ndarray) -> np.ndarray:
    return channel.scale * (values - channel.zero)


def _shown(quantity: str, per_shown: float, shown: str, force: str) -> tuple[float, str]:
    if quantity == "torque":
        return 1.0, force
    return per_shown, shown if quantity == "position" else f"{shown}/s"
