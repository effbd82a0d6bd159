"""What reversals tell of lags beside what all other rows do: how both are put together."""

from functools import cache
from typing import Any
from unittest.mock import create_autospec

import numpy as np
import pytest
from scipy.signal import lfilter

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects import lags as module
from deltaid.effects import timing
from deltaid.effects.at_drives import DriveSpring
from deltaid.effects.lags import Lags, estimate_lags
from deltaid.effects.reversals import ReversalLags, lags_of_reversals
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.traces import Trace, trace
from deltaid.levels import ROUNDS
from deltaid.motion.random_motion import random_motion
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.load import load_robot
from logs import tabled

RATE, NOTHING = 250.0, np.full(3, np.inf)


@cache
def recording(dead: float = 2e-3, constant: float = 0.0, noise: float = 0.02) -> Trace:
    """Five seconds of a robot whose torques come late, and through a filter; reversals left out."""
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(3)
    motion, t = random_motion(dynamics.kinematics, rng, period=2.3), np.arange(1250) / RATE
    q = dynamics.kinematics.drive_motion(*motion.evaluate(t))[0]
    every = 16 if constant else 1  # a filter of what is between two samples too
    fine = np.arange(1250 * every) / RATE / every - dead
    z, zd, zdd = motion.evaluate(fine)
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    tau = dynamics.torque(z, qd, qdd)
    if constant:
        a = np.exp(-1 / (RATE * every * constant))
        tau = lfilter([1 - a], [1, -a], tau, axis=0)[::every]
    tau = tau + noise * rng.standard_normal(q.shape)
    prepared = with_filter(open_log(tabled(t=t, q=q, tau=tau), dynamics.kinematics), 12.0)
    load = prior_parameters(dynamics.robot)
    return trace(dynamics, prepared, load, cutoff=12.0)


@pytest.mark.parametrize(
    ("dead", "constant"), [(2e-3, 0.0), (-1e-3, 0.0), (0.0, 3.3e-3), (1e-3, 3.3e-3)]
)
def test_reversals_tell_a_lag_and_whether_there_is_a_filter(dead: float, constant: float) -> None:
    p = prior_parameters(compiled(load_robot("clavel-delta3")).robot)
    lag = dead + constant
    found = lags_of_reversals(recording(dead, constant), (), p, np.full(3, lag + 3e-4))
    np.testing.assert_array_less(np.abs(found.values - lag), 2 * found.deviation)
    assert found.deviation.max() < 5e-4  # an eighth of a sample
    assert found.filtered.tolist() == [constant > 0] * 3
    assert not found.doubtful.any()


def test_steps_are_found_where_other_rows_imitate_a_large_lag() -> None:
    """As motors that saturate do."""
    p = prior_parameters(compiled(load_robot("clavel-delta3")).robot)
    for lag in (-2e-3, 2e-3):
        found = lags_of_reversals(recording(lag), (), p, np.array([lag, -10 * lag, -10 * lag]))
        np.testing.assert_array_less(np.abs(found.values - lag), 2 * found.deviation)
        assert found.deviation.max() < 5e-4


@pytest.mark.parametrize("constant", [0.0, 3.3e-3])
def test_a_filter_whose_tails_are_in_noise_is_no_step_at_once(constant: float) -> None:
    p = prior_parameters(compiled(load_robot("clavel-delta3")).robot)
    found = lags_of_reversals(recording(0.0, constant, noise=2.0), (), p, np.full(3, constant))
    np.testing.assert_array_less(np.abs(found.values - constant), 2 * found.deviation)
    assert found.filtered.tolist() == [constant > 0] * 3


@pytest.mark.parametrize(
    ("dead", "constant", "noise"),
    [(5e-3, 0.0, 1.0), (4.6e-3, 0.0, 0.02), (7e-3, 0.0, 0.02), (1e-3, 3.3e-3, 0.02)],
)
def test_filters_settle_where_steps_of_friction_fall_between_two_rows(
    monkeypatch: pytest.MonkeyPatch, dead: float, constant: float, noise: float
) -> None:
    rounds = create_autospec(timing.timing_slopes, side_effect=timing.timing_slopes)
    monkeypatch.setattr(timing, "timing_slopes", rounds)
    dynamics, sharp = compiled(load_robot("clavel-delta3")), np.zeros(3, bool)
    rows = TraceRows.for_dynamics(dynamics, (), 0.5)
    record, p = recording(dead, constant, noise), prior_parameters(dynamics.robot)
    timing.other_than_delays(rows, record, np.full(3, dead + constant), sharp, sharp, p)
    assert 1 < rounds.call_count < ROUNDS // 2


def test_a_time_constant_of_a_filter_is_right() -> None:
    dynamics, sharp = compiled(load_robot("clavel-delta3")), np.zeros(3, bool)
    rows, p = TraceRows.for_dynamics(dynamics, (), 0.5), prior_parameters(dynamics.robot)
    filters, _ = timing.other_than_delays(
        rows, recording(0.0, 6e-3), np.full(3, 6e-3), sharp, sharp, p
    )
    assert filters is not None
    np.testing.assert_allclose(filters.constants, 6e-3, rtol=0.05)
    blurred = timing.other_than_delays(
        rows, recording(0.0, 6e-3), np.full(3, 6e-3), sharp, ~sharp, p
    )
    assert blurred[0] is None


@pytest.fixture
def lags_together(monkeypatch: pytest.MonkeyPatch):
    """Lags where reversals tell so much."""

    def estimate(
        values: np.ndarray,
        deviation: np.ndarray,
        filtered: tuple[int, ...] = (),
        doubtful: tuple[int, ...] = (),
        blurred: tuple[int, ...] = (),
        additions: tuple[Addition, ...] = (),
    ) -> Lags:
        def reversal_lags(*_: object) -> ReversalLags:
            flags = (np.isin(np.arange(3), which) for which in (filtered, doubtful))
            blur = 4e-3 * np.isin(np.arange(3), blurred)
            return ReversalLags(values, deviation, *flags, blur)

        monkeypatch.setattr(module, "lags_of_reversals", reversal_lags)
        return estimate_lags([recording()], additions, spread=0.5)

    return estimate


@pytest.fixture
def others(lags_together) -> tuple[np.ndarray, np.ndarray]:
    """What all other rows say, and its covariance, where reversals tell nothing."""
    found = lags_together(np.zeros(3), NOTHING)
    np.testing.assert_allclose(found.values[0], 2e-3, atol=2e-4)
    return found.values[0], found.covariance[0]


def test_what_agrees_is_a_weighted_mean(lags_together, others) -> None:
    rough, covariance = others
    variance = np.diag(covariance)
    steps, std = np.add(rough, [2e-5, -1e-5, 3e-5]), np.array([1e-5, 4e-5, 2e-4])
    found = lags_together(steps, std)
    weights = np.array([std**-2.0, 1 / variance])
    mean = np.sum(weights * [steps, rough], axis=0) / weights.sum(axis=0)
    np.testing.assert_allclose(found.values[0], mean, rtol=1e-9)
    np.testing.assert_allclose(found.covariance[0], np.diag(1 / weights.sum(axis=0)), rtol=1e-9)
    assert found.agrees.all()


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_what_is_three_deviations_apart_disagrees(lags_together, others, share: float) -> None:
    """Then reversals alone are believed, which nothing else can imitate."""
    rough, covariance = others
    std = 0.5 * np.sqrt(np.diag(covariance))
    apart = share * 3 * np.hypot(std[1], 2 * std[1])
    found = lags_together(np.add(rough, [0.0, apart, 0.0]), std)
    assert found.agrees[0].tolist() == [True, share < 1, True]
    if share > 1:
        assert found.values[0, 1] == pytest.approx(rough[1] + apart)
        assert found.covariance[0, 1, 1] == pytest.approx(std[1] ** 2)


@pytest.fixture
def beside_any_law(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, ...]]:
    """Lags and covariances of sweeps with friction of any law, as they come."""
    swept, results = module._swept, list[tuple[np.ndarray, ...]]()

    def spied(*args: Any, any_friction: bool = False) -> tuple[np.ndarray, ...]:
        result = swept(*args, any_friction=any_friction)
        results.extend([result] * any_friction)
        return result

    monkeypatch.setattr(module, "_swept", spied)
    return results


@pytest.mark.parametrize("kind", ["filtered", "blurred"])
def test_a_filter_that_other_rows_contradict_is_as_uncertain_as_both_are_apart(
    lags_together, others, beside_any_law, kind: str
) -> None:
    """Friction that yields looks like one."""
    rough, covariance = others
    steps, std = np.add(rough, [0.0, 4e-3, 0.0]), np.full(3, 5e-5)
    lags = lags_together(steps, std, **{kind: (1,)})
    ((values, errors, _),) = beside_any_law
    assert np.isinf(lags.step_std[0, 1])
    assert lags.agrees.all()
    mean, half = 0.5 * (values[0, 1] + steps[1]), 0.5 * (steps[1] - values[0, 1])
    assert abs(values[0, 1] - rough[1]) < 3e-4
    assert errors[0, 1, 1] > covariance[1, 1]
    assert lags.values[0, 1] == pytest.approx(mean, rel=1e-12)
    assert lags.covariance[0, 1, 1] == pytest.approx(errors[0, 1, 1] + half**2, rel=1e-12)
    assert lags.covariance[0, 0, 0] < std[0] ** 2
    assert not lags.blur.any()
    assert lags.blurred(0) == ()
    agreed = lags_together(rough + 1e-5, std, **{kind: (0, 1, 2)})
    assert np.all(np.isfinite(agreed.step_std))
    assert not agreed.abrupt.any()
    assert agreed.blurred(0) == ((4e-3,) * 3 if kind == "blurred" else ())
    assert len(beside_any_law) == 1


@pytest.mark.parametrize("known", [NOTHING, np.array([5e-5, np.inf, np.inf])])
def test_where_steps_follow_no_law_lags_are_also_estimated_beside_any_law(
    lags_together, others, beside_any_law, known: np.ndarray
) -> None:
    """Of drives of which reversals say nothing themselves."""
    rough, _ = others
    by_law = lags_together(rough, known)
    lags = lags_together(rough, known, doubtful=(0, 2))
    ((values, errors, _),) = beside_any_law
    free = np.isinf(known) & [True, False, True]
    expected = np.where(free, 0.5 * (values[0] + rough), by_law.values[0])
    np.testing.assert_allclose(lags.values[0], expected, rtol=1e-12)
    own = np.diag(errors[0]) + 0.25 * (values[0] - rough) ** 2
    variance = np.where(free, own, np.diag(by_law.covariance[0]))
    np.testing.assert_allclose(np.diag(lags.covariance[0]), variance, rtol=1e-12)
    assert not np.any(lags.covariance[0][np.ix_(free, ~free)])


def test_additions_take_part_beside_any_law(lags_together, others, beside_any_law) -> None:
    dynamics, (rough, _) = recording().dynamics, others
    spring = DriveSpring(dynamics, (1,), (1.0,))
    lags_together(rough, NOTHING, doubtful=(0,), additions=(spring,))
    ((values, _, p),) = beside_any_law
    assert len(p) == len(dynamics.layout.names) + 1
    np.testing.assert_allclose(values[0], 2e-3, atol=3e-4)
