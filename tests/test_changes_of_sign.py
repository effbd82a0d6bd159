"""Outliers that come where drives reverse or gear torques change their sign are no pushes."""

import numpy as np
import pytest

from deltaid.identification.outliers import Outliers, OutlierStretch, at_changes
from deltaid.recording.filter import design_low_pass
from pushes import Force, moving, recorded, spans_left_out, torques

CLAVEL = "clavel-delta3"


@pytest.mark.parametrize("later", [0.0, 0.15])
def test_pushes_where_a_drive_reverses_may_come_from_the_drives(later: float) -> None:
    """Pushes that come with the reversals of a drive, and the same ones that come later."""
    setting = moving(CLAVEL)
    speed = setting.truth.qd[:, 0]
    turns = setting.time[1:][np.signbit(speed[1:]) != np.signbit(speed[:-1])] + later
    turns = turns[(turns > 0.5) & (turns < 9.5)]
    directions = np.random.default_rng(4).normal(size=(len(turns), 3))
    pushes = tuple(
        Force(t - 0.02, t + 0.02, tuple(100.0 * x / np.linalg.norm(x)))
        for t, x in zip(turns.tolist(), directions, strict=True)
    )
    spans = spans_left_out(CLAVEL, recorded(setting, torques(setting, pushes)))
    assert len(spans) == len(turns) >= 4
    assert {span.reason for span in spans} == {"contact" if later else "change of sign"}
    assert all(span.push for span in spans)


def outliers_at(peaks: list[float], sizes: list[float], turns: list[float]) -> np.ndarray:
    """Which outliers recur at changes of sign, in 100 s of a recording."""
    zero = np.zeros(3)
    stretches = tuple(
        OutlierStretch(t, t, np.array([size, 0.1, 0.1]), t, zero, zero, zero, 0.0)
        for t, size in zip(peaks, sizes, strict=True)
    )
    none, times, recur = np.zeros(0), np.array(turns), list[np.ndarray]()
    for changes in ((none, times, none), (none,) * 3), ((none,) * 3, (times, none, none)):
        outliers = Outliers(stretches, (), 100.0, *changes)
        low_pass = design_low_pass(20.0, 1000.0, single=True)
        recur.append(at_changes(outliers, stretches, low_pass))
    np.testing.assert_array_equal(*recur)
    return recur[0]


def test_outliers_recur_at_changes_of_sign_if_nearly_all_are_there() -> None:
    turns = np.arange(1.0, 100.0, 2.0).tolist()
    here, away = turns[:40], [t + 0.5 for t in turns]
    assert outliers_at(here, [2.0] * 40, turns).all()
    assert not outliers_at(away[:40], [2.0] * 40, turns).any()
    assert not outliers_at([*here[:9], *away[:9]], [2.0] * 18, turns).any()
    assert not outliers_at(here[:1], [2.0], turns).any()
    # One elsewhere that is as large as the others belongs to them, one that is larger does not.
    assert outliers_at([*here, away[0]], [2.0] * 40 + [2.5], turns).all()
    assert outliers_at([*here, away[0]], [2.0] * 40 + [5.0], turns).tolist() == [True] * 40 + [
        False
    ]
    assert outliers_at(here, [2.0] * 39 + [12.0], turns).tolist() == [True] * 39 + [False]
    assert not outliers_at([], [], turns).any()
    nothing = Outliers((), (), 0.0, (), ())
    assert not at_changes(nothing, (), design_low_pass(20.0, 1000.0, single=True)).any()


def test_outliers_are_nowhere_else_where_all_times_are_near_changes_of_sign() -> None:
    turns = np.arange(0.0, 100.0, 0.01).tolist()
    assert not outliers_at(turns[:40], [2.0] * 40, turns).any()
    assert not outliers_at([*turns[:40], 200.0], [2.0] * 41, turns).any()
