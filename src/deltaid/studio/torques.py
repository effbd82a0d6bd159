"""Torques of several models beside those of a recording, for one figure over time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.identification.as_identified import model_filtered
from deltaid.model.model import load
from deltaid.recording.mapping import load_mapping
from deltaid.recording.opening import open_log
from deltaid.report.comparison import compare


@dataclass(frozen=True)
class Beside:
    """What models predict of a recording.

    Attributes:
        drives, units: names, and what their torques or forces are in.
        time: one array a model [s]; each is filtered as its own recordings were.
        measured, predicted: one array a model (samples, drives).
    """

    drives: tuple[str, ...]
    units: tuple[str, ...]
    time: tuple[Float[np.ndarray, " _"], ...]
    measured: tuple[Float[np.ndarray, "_ _"], ...]
    predicted: tuple[Float[np.ndarray, "_ _"], ...]


def torques(path: str, mapping: str | None, models: Sequence[str]) -> Beside:
    """Measured torques of a recording and those that models predict.

    Raises:
        DeltaidError: recording, mapping or a model cannot be used, or they are of other robots.
    """
    given = load_mapping(mapping) if mapping else None
    time, measured, predicted = [], [], []
    robot = load(models[0]).robot
    for name in models:
        model = load(name)
        log = open_log(path, model.dynamics.kinematics, given)
        found = compare(model.dynamics, model.p, model_filtered(model, log))
        time.append(found.time)
        measured.append(found.measured.astype(np.float32))
        predicted.append(found.predicted.astype(np.float32))
    units = tuple(robot.units(drive).force for drive in robot.drives)
    return Beside(tuple(robot.drives), units, tuple(time), tuple(measured), tuple(predicted))
