"""A few recordings of the study in `benchmarks/verdicts.py`, and what its generator says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deltaid.model.verdict import Grade, Verdict
from faults import LEAST, Case, clean, fault
from faults.score import said_of, score
from faults.shown import shown
from support import assert_torques

# A linear Delta at 500 Hz.
SEED = 8


@cache
def careful() -> Case:
    return clean(SEED, "linear-delta")


@pytest.mark.parametrize(
    "kind", ["torque-sign", "torque-lag", "stribeck", "clock-gaps", "torque-limit"]
)
def test_faults_are_said(kind: str) -> None:
    case = fault(careful(), kind, np.random.default_rng(1))
    found = score(case, said_of(case))
    assert found.right, f"{case.size}: {found.said}"


def test_nothing_is_said_of_a_clean_recording() -> None:
    found = score(careful(), said_of(careful()))
    assert found.right, found.said


def test_torques_are_those_of_the_true_robot() -> None:
    # The oracle knows nothing of the package: that both agree is physics.
    case = careful()
    assert_torques(case.robot, case.setting.truth, case.setting.plant.p)


def test_a_fault_shows_in_proportion_to_its_size() -> None:
    case = careful()
    offset = np.array([1.0, 0.0, 0.0])

    def homed(size: float) -> float:
        exact = case.exact
        columns = dict(exact.columns) | {"q": exact.columns["q"] + size * offset}
        return shown(replace(exact, columns=columns), case)

    assert homed(0.0) < 0.05 * LEAST
    assert homed(2e-3) > LEAST
    assert homed(2e-3) == pytest.approx(2 * homed(1e-3), rel=0.05)


def test_scores() -> None:
    case = replace(careful(), keys=("gear",), related=("angle-unit",), subject="drive2")

    def said(*pairs: tuple[str, Grade, str]) -> bool:
        return score(case, [Verdict(key, grade, "", about) for key, grade, about in pairs]).right

    right = ("gear", Grade.WRONG, "drive2")
    assert said(right)
    assert said(("gear", Grade.DOUBTFUL, "drive2"), ("angle-unit", Grade.WRONG, ""))
    assert said(right, ("drift", Grade.DOUBTFUL, ""), ("rate", Grade.GOOD, ""))
    assert not said(right, ("drift", Grade.WRONG, ""))
    assert not said(("gear", Grade.WRONG, "drive1"))
    assert not said(("gear", Grade.CANNOT_TELL, "drive2"))
    assert not said(("angle-unit", Grade.WRONG, "drive2"))
    assert not said()
