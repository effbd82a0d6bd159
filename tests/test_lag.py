"""The lag between torques and positions, drive by drive, with the parameters."""

from functools import cache

import numpy as np
import polars as pl
import pytest
from scipy import stats

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.lags import Lags, estimate_lags
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.traces import Trace, trace
from deltaid.motion.fourier import FourierMotion
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.load import load_robot

RATE, DURATION = 500.0, 12.0


@cache
def moving(name: str = "clavel-delta3") -> tuple[Dynamics, np.ndarray, FourierMotion]:
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(2)
    p = surrogate_parameters(dynamics.robot, rng)
    return dynamics, p, random_motion(dynamics.kinematics, rng, period=4.217)


def frame(late: np.ndarray, noise: float = 0.02, rate: float = RATE) -> pl.DataFrame:
    """A recording whose torques come late by so much, drive by drive."""
    dynamics, p, motion = moving()
    t = np.arange(round(DURATION * rate)) / rate

    def at(time: np.ndarray) -> tuple[np.ndarray, ...]:
        z, zd, zdd = motion.evaluate(time)
        q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
        return q, dynamics.torque(z, qd, qdd, p)

    q, _ = at(t)
    tau = np.stack([at(t - lag)[1][:, i] for i, lag in enumerate(late)], axis=1)
    rng = np.random.default_rng(3)
    tau += noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    columns = {"t": t}
    columns |= {f"q{i + 1}": 1e-6 * np.round(1e6 * x) for i, x in enumerate(q.T)}
    return pl.DataFrame(columns | {f"tau{i + 1}": x for i, x in enumerate(tau.T)})


def traced(table: pl.DataFrame) -> Trace:
    dynamics, _, _ = moving()
    recording = with_filter(open_log(table, dynamics.kinematics), 15.0)
    return trace(dynamics, recording, prior_parameters(dynamics.robot), cutoff=15.0)


def found(table: pl.DataFrame) -> Lags:
    """With a wide prior: a surrogate's parameters are far from it."""
    return estimate_lags([traced(table)], spread=1.0)


@pytest.mark.parametrize("late", [-7.3e-3, 0.0, 0.6e-3, 13.1e-3])
def test_a_common_lag_is_found_with_an_interval_that_holds_it(late: float) -> None:
    lag = found(frame(np.full(3, late))).common(0)
    assert np.ptp(lag.values) == 0
    assert lag.values[0] == pytest.approx(late, abs=1.5 * lag.interval[0])
    assert lag.interval[0] < 0.3e-3


def test_lags_of_drives_are_told_apart() -> None:
    late = np.array([2e-3, 2e-3, -1.5e-3])
    lag = found(frame(late)).each(0)
    np.testing.assert_array_less(np.abs(lag.values - late), 1.5 * lag.interval)
    assert lag.interval.max() < 0.5e-3


def test_a_common_lag_is_the_mean_by_generalised_least_squares() -> None:
    rng = np.random.default_rng(0)
    root, values = rng.standard_normal((3, 3)), rng.standard_normal(3)
    C = root @ root.T
    nothing = np.zeros((1, 3))
    lags = Lags(values[None], C[None], nothing, nothing, nothing > 0, nothing > 0, np.zeros(0))
    inverse = np.linalg.inv(C)
    lag = lags.common(0)
    np.testing.assert_allclose(lag.values, inverse.sum(axis=0) @ values / inverse.sum())
    np.testing.assert_allclose(lag.deviation, inverse.sum() ** -0.5)
    np.testing.assert_allclose(lags.each(0).deviation, np.sqrt(np.diag(C)))
    np.testing.assert_allclose(lag.interval, stats.t.ppf(0.975, STRETCHES - 1) * lag.deviation)


def test_without_noise_a_lag_and_the_parameters_come_out() -> None:
    lag = found(frame(np.full(3, 4e-3), noise=0.0))
    assert lag.values[0] == pytest.approx(
        np.full(3, 4e-3), abs=0.15e-3
    )  # reversals: a sample is 2 ms
    dynamics, p, motion = moving()
    z, zd, zdd = motion.evaluate(np.linspace(0, 4, 50))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    expected = dynamics.torque(z, qd, qdd, p)
    predicted = dynamics.torque(z, qd, qdd, lag.p)
    assert np.abs(predicted - expected).max() < 0.02 * np.abs(expected).max()


def test_torques_are_shifted_by_parts_of_a_sample() -> None:
    late, (_, p, _) = traced(frame(np.full(3, 2.7e-3), noise=0.0)), moving()

    def off(one: Trace) -> float:
        """What the true parameters leave of the torques, as a share."""
        left = one.torques() - one.model(p)
        return float(np.abs(left).max() / np.abs(one.torques()).max())

    assert off(late.shifted(np.full(3, 2.7e-3))) < 0.1 * off(late)


def test_a_recording_that_is_too_short_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"too few|too short"):
        traced(frame(np.zeros(3)).head(200))


def test_of_a_long_log_a_few_runs_are_kept() -> None:
    dynamics, _, _ = moving()
    log = open_log(frame(np.zeros(3), rate=2000.0), dynamics.kinematics)  # three windows
    recording = with_filter(log, 15.0)
    load = prior_parameters(dynamics.robot)
    whole, some = (
        trace(dynamics, recording, load, cutoff=15.0, windows=most) for most in (None, 2)
    )
    assert len(whole.stretches) == 1
    first, last = some.stretches
    assert first.time[0] == whole.stretches[0].time[0]
    assert last.time[-1] == whole.stretches[0].time[-1]
    assert len(first.time) + len(last.time) < 0.7 * len(whole.stretches[0].time)
