"""Figures of a recording with a load compare torques as the table of errors does."""

from collections.abc import Callable

import numpy as np
import polars as pl
import pytest

from deltaid.identification.prediction import Validation, validate
from deltaid.model.model import load
from deltaid.view import model_pages
from deltaid.view.comparison import TorqueComparison, compare
from logs import tabled
from support import along

MASS = 1.0


@pytest.fixture(scope="module")
def validated() -> Validation:
    """A Delta at its prior that holds a declared kilogram all the time."""
    model = load("clavel-delta3")
    time = np.arange(4000) / 1000
    _, q, qd, qdd = along(model.dynamics.kinematics, np.random.default_rng(6), time, period=3.0)
    z = model.dynamics.kinematics.forward(q)
    carried = np.append(MASS, np.zeros(9))
    log: pl.DataFrame = tabled(
        t=time, q=q, tau=model.dynamics.torque(z, qd, qdd, model.with_load(carried).p)
    )
    held = {"load": {"mass": MASS, "centre": [0.0, 0.0, 0.0], "always": True}}
    return validate(model, log, columns=held)


@pytest.mark.parametrize("draw", [model_pages.validation_page, model_pages.validation_figure])
def test_a_figure_has_the_torques_without_the_load(
    draw: Callable[[Validation], object], validated: Validation, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[TorqueComparison]()

    def spied(*arguments: object) -> TorqueComparison:
        drawn.append(compare(*arguments))
        return drawn[-1]

    monkeypatch.setattr(model_pages, "compare", spied)
    draw(validated)
    (comparison,) = drawn
    left = np.nanstd(comparison.predicted - comparison.measured, axis=0)
    assert np.all(left < 1e-3 * np.nanstd(comparison.measured, axis=0))
    assert validated.error.nrmse.max() < 1e-3
