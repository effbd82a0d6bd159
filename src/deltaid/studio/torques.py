"""Torques of models beside those of a recording, for figures over time and tables of errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deltaid.model.model import Model, load
from deltaid.recording.mapping import load_mapping
from deltaid.studio.decimate import MinMax
from deltaid.studio.folder import stamp

if TYPE_CHECKING:
    from deltaid.view.comparison import Comparison

# Points of a curve at most; a screen has hardly more columns.
_POINTS = 1600
# Comparisons that are kept, such as of two models with a few recordings.
_KEPT = 12


@dataclass(frozen=True)
class Line:
    """A thinned curve of one drive: what was measured, or what a model makes of it.

    Attributes:
        model: its number among those that were asked for; None for what was measured.
        time: [s].
        values: torque, or predicted minus measured torque [N m or N].
    """

    drive: int
    model: int | None
    time: Float[np.ndarray, " points"]
    values: Float[np.ndarray, " points"]


@dataclass(frozen=True)
class Beside:
    """What models predict of a recording.

    Attributes:
        drives, units: names, and what their torques or forces are in.
        torques, errors: curves.
        nrmse: of each model and drive.
    """

    drives: tuple[str, ...]
    units: tuple[str, ...]
    torques: tuple[Line, ...]
    errors: tuple[Line, ...]
    nrmse: Float[np.ndarray, "models drives"]


def torques(
    path: str,
    mapping: str | None,
    models: Sequence[str],
    span: tuple[float, float] | None = None,
) -> Beside:
    """Measured torques of a recording and those that models predict.

    Args:
        path, mapping, models: files.
        span: first and last second to be shown; None for all.

    Raises:
        DeltaidError: recording, mapping or a model cannot be used, or they are of other robots.
    """
    changed = tuple(stamp(Path(one)) for one in (path, mapping, *models) if one)
    found = [_compared(path, mapping, model, changed) for model in models]
    robot = load(models[0]).robot
    lines: list[Line] = []
    errors: list[Line] = []
    for number, (seen, _) in enumerate(found):
        if number == 0:
            lines += _lines(None, seen.time, seen.measured, span)
        lines += _lines(number, seen.time, seen.predicted, span)
        errors += _lines(number, seen.time, seen.predicted - seen.measured, span)
    return Beside(
        drives=tuple(robot.drives),
        units=tuple(robot.units(drive).force for drive in robot.drives),
        torques=tuple(lines),
        errors=tuple(errors),
        nrmse=np.array([nrmse for _, nrmse in found]),
    )


@lru_cache(_KEPT)
def _compared(
    path: str, mapping: str | None, name: str, _changed: tuple[object, ...]
) -> "tuple[Comparison, Float[np.ndarray, ' drives']]":
    # The server knows this module and need not wait for those.
    from deltaid.identification.loads import as_known
    from deltaid.identification.sources import model_filtered
    from deltaid.identification.torque_error import torque_error
    from deltaid.recording.opening import open_log
    from deltaid.view.comparison import compare

    given = load_mapping(mapping) if mapping else None
    model: Model = load(name)
    log = open_log(path, model.dynamics.kinematics, given)
    recording = as_known(model_filtered(model, log), model)
    found = compare(model.dynamics, model.p, recording)
    return found, torque_error(model.dynamics, model.p, recording).nrmse


def _lines(
    model: int | None,
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples drives"],
    span: tuple[float, float] | None,
) -> list[Line]:
    thin = MinMax(values.shape[1], _POINTS, span)
    thin.add(time, values)
    return [Line(k, model, *thin.curve(k)) for k in range(values.shape[1])]
