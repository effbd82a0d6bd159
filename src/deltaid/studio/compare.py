"""Models side by side: torques along a recording, errors, and what their runs say in numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.model.model import Model, load
from deltaid.recording.mapping import load_mapping
from deltaid.studio.folder import Folder, stamp
from deltaid.studio.look import POINTS, MinMax
from deltaid.studio.runs import FinishedRun, output
from deltaid.view.numbers import number, percent

if TYPE_CHECKING:
    from deltaid.view.comparison import TorqueComparison


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
    changed = tuple(stamp(Path(name)) for name in (path, mapping, *models) if name)
    found = [_compared(path, mapping, model, changed) for model in models]
    robot = load(models[0]).robot
    lines = _lines(None, found[0][0].time, found[0][0].measured, span)
    errors: list[Line] = []
    for k, (seen, _) in enumerate(found):
        lines += _lines(k, seen.time, seen.predicted, span)
        errors += _lines(k, seen.time, seen.predicted - seen.measured, span)
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
) -> "tuple[TorqueComparison, Float[np.ndarray, ' drives']]":
    # The server knows this module and need not wait for those.
    from deltaid.identification.loads import as_known
    from deltaid.identification.sources import model_filtered
    from deltaid.identification.torque_error import torque_error
    from deltaid.recording.opening import open_log
    from deltaid.view.comparison import compare

    model: Model = load(name)
    log = open_log(path, model.dynamics.kinematics, load_mapping(mapping) if mapping else None)
    recording = as_known(model_filtered(model, log), model)
    seen = compare(model.dynamics, model.p, recording)
    return seen, torque_error(model.dynamics, model.p, recording).nrmse


def _lines(
    model: int | None,
    time: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples drives"],
    span: tuple[float, float] | None,
) -> list[Line]:
    thin = MinMax(values.shape[1], POINTS, span)
    thin.add(time, values)
    return [Line(k, model, *thin.curve(k)) for k in range(values.shape[1])]


# Parameters of a comparison: those that changed most, in standard deviations of both.
_SHOWN = 12
# Endings of inputs that are no recordings.
_TEXT = (".yaml", ".yml")
_KINDS = {"good": "good", "poor": "bad"}


def describe_fit(folder: Folder, run: FinishedRun) -> list[tuple[str, str]]:
    """Sentences about a fit, each with its kind of note: '', 'good', 'doubt' or 'bad'."""
    summary = output(folder, run).get("summary")
    if not isinstance(summary, dict):
        return []
    kind = _KINDS.get(str(summary["grade"]), "doubt")
    return [(str(summary["sentence"]), kind), ("\n".join(summary["lines"]), "")]


def comparison(folder: Folder, pair: Sequence[FinishedRun]) -> list[tuple[str, ...]]:
    """Rows of a table of runs: errors, noise, rank, settings, parameters that differ most."""
    found = [output(folder, run) for run in pair]
    rows: list[tuple[str, ...]] = [
        ("verdict", *(str(result.get("summary", {}).get("sentence", "–")) for result in found)),
        ("robot", *(str(result.get("robot", "")) for result in found)),
        (
            "recordings",
            *(
                ", ".join(r.file for r in run.record.inputs if not r.file.endswith(_TEXT))
                for run in pair
            ),
        ),
        ("error on them", *(_share(result.get("nrmse")) for result in found)),
        (
            "error on an unseen motion",
            *(_share((result.get("verify") or {}).get("nrmse")) for result in found),
        ),
        ("torque noise", *(percent(result["noise_level"]) for result in found)),
        ("base parameters", *(str(result["base_parameters"]) for result in found)),
        ("corrections", *(str(len(result["corrections"])) for result in found)),
        ("γ", *(number(result["gamma"], 3) for result in found)),
    ]
    return rows + _parameters(folder, pair)


def _parameters(folder: Folder, pair: Sequence[FinishedRun]) -> list[tuple[str, ...]]:
    try:
        models = [load(folder.root / run.file("model.yaml")).identified for run in pair]
    except DeltaidError:
        return []
    known = [{p.name: p for p in model.parameters} for model in models if model]
    if len(known) != 2 or len(pair) != 2:
        return []
    left, right = known
    shared = [name for name in left if name in right and left[name].value != right[name].value]

    def apart(name: str) -> float:
        scale = left[name].std + right[name].std
        return -abs(left[name].value - right[name].value) / scale if scale else 0.0

    return [
        (
            f"{name} [{left[name].unit}]",
            *(f"{side[name].value:.4g} ({side[name].low:.3g} … {side[name].high:.3g})"
              for side in (left, right)),
        )
        for name in sorted(shared, key=apart)[:_SHOWN]
    ]  # fmt: skip


def _share(values: Sequence[float] | None) -> str:
    return percent(max(values)) if values else "–"
