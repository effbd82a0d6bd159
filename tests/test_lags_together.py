"""What reversals tell of lags beside what all other rows do: how both are put together."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects import lags as module
from deltaid.effects.lags import Lags, estimate_lags
from deltaid.effects.reversals import ReversalLags, lags_of_reversals
from deltaid.estimation.traces import Trace, trace
from deltaid.motion.random_motion import random_motion
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.load import load_robot
from logs import tabled

RATE, NOTHING = 250.0, np.full(3, np.inf)


@cache
def recording(dead: float = 2e-3, constant: float = 0.0) -> Trace:
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
    tau = tau + 0.02 * rng.standard_normal(q.shape)
    one = with_filter(open_log(tabled(t=t, q=q, tau=tau), dynamics.kinematics), 12.0)
    load = prior_parameters(dynamics.robot)
    return trace(dynamics, one, load, cutoff=12.0)


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


@pytest.fixture
def lags_together(monkeypatch: pytest.MonkeyPatch):
    """Lags where reversals tell so much."""

    def estimate(
        values: np.ndarray,
        deviation: np.ndarray,
        filtered: tuple[int, ...] = (),
        doubtful: tuple[int, ...] = (),
    ) -> Lags:
        def seen(*_: object) -> ReversalLags:
            flags = (np.isin(np.arange(3), which) for which in (filtered, doubtful))
            return ReversalLags(values, deviation, *flags)

        monkeypatch.setattr(module, "lags_of_reversals", seen)
        return estimate_lags([recording()], spread=0.5)

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


def test_a_filter_that_other_rows_contradict_is_not_told(lags_together, others) -> None:
    """Friction that yields looks like one; how late this drive is is in doubt by 3 ms."""
    rough, _ = others
    steps, std = np.add(rough, [0.0, 4e-3, 0.0]), np.full(3, 5e-5)
    found = lags_together(steps, std, filtered=(1,))
    assert np.isinf(found.step_std[0, 1])
    assert found.agrees.all()
    assert abs(found.values[0, 1] - rough[1]) < 2e-4
    assert found.covariance[0, 1, 1] == pytest.approx(3e-3**2, rel=0.1)
    assert found.covariance[0, 0, 0] < std[0] ** 2
    agreed = lags_together(rough + 1e-5, std, filtered=(0, 1, 2))
    assert np.all(np.isfinite(agreed.step_std))


@pytest.mark.parametrize("known", [NOTHING, np.array([5e-5, np.inf, np.inf])])
def test_steps_that_follow_no_law_leave_a_lag_in_doubt(
    lags_together, others, known: np.ndarray
) -> None:
    """Where nothing is told of a drive for that; those that are told are in none."""
    rough, _ = others
    found = lags_together(rough, known, doubtful=(0, 2))
    more = found.covariance[0] - lags_together(rough, known).covariance[0]
    expected = 3e-3**2 * (np.isinf(known) & [True, False, True])
    np.testing.assert_allclose(more, np.diag(expected), atol=1e-12)
