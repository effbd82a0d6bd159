"""Figures of a recording with a load compare torques as the table of errors does."""

from collections.abc import Callable

import numpy as np
import pytest

from deltaid.identification.prediction import Validation, validate
from deltaid.model.model import Model, load
from deltaid.view import model_pages
from deltaid.view.comparison import TorqueComparison, compare
from identified import identified
from logs import tabled
from support import along

MASS = 1.0


def holding(model: Model) -> Validation:
    """A robot with exactly a model's parameters that holds a declared kilogram all the time."""
    time, kinematics = np.arange(4000) / 1000, model.dynamics.kinematics
    z, q, qd, qdd = along(kinematics, np.random.default_rng(6), time, period=3.0)
    p = model.with_load(np.append(MASS, np.zeros(9))).p
    log = tabled(t=time, q=q, tau=model.dynamics.torque(z, qd, qdd, p))
    held = {"load": {"mass": MASS, "centre": [0.0, 0.0, 0.0], "always": True}}
    return validate(model, log, columns=held)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[TorqueComparison]:
    """Comparisons that pages draw."""
    comparisons = list[TorqueComparison]()

    def spied(*arguments: object) -> TorqueComparison:
        comparisons.append(compare(*arguments))
        return comparisons[-1]

    monkeypatch.setattr(model_pages, "compare", spied)
    return comparisons


def left(comparison: TorqueComparison) -> float:
    residual = np.nanstd(comparison.predicted - comparison.measured, axis=0)
    return float(np.max(residual / np.nanstd(comparison.measured, axis=0)))


@pytest.mark.parametrize("draw", [model_pages.validation_page, model_pages.validation_figure])
def test_a_figure_has_the_torques_without_the_load(
    draw: Callable[[Validation], object], drawn: list[TorqueComparison]
) -> None:
    validated = holding(load("clavel-delta3"))
    draw(validated)
    (comparison,) = drawn
    assert left(comparison) < 1e-3
    assert validated.error.nrmse.max() < 1e-3


def test_a_verification_has_the_torques_without_the_load(drawn: list[TorqueComparison]) -> None:
    result = identified("clavel-delta3").result
    model_pages.identification_page(result, holding(load(result.model)))
    assert left(drawn[-1]) < 1e-3
