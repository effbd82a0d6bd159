"""The lag between torques and positions, drive by drive, with the parameters."""

from functools import cache

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import DriveRows
from deltaid.estimation.span import Span
from deltaid.identification.lag import REACH, coarse_lag, estimate_lag
from deltaid.identification.traces import Trace, trace
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


def traced(table: pl.DataFrame, **options: bool) -> tuple[Trace, DriveRows, Span]:
    dynamics, _, _ = moving()
    recording = with_filter(open_log(table, dynamics.kinematics), 15.0)
    load = prior_parameters(dynamics.robot)
    one = trace(dynamics, recording, load, cutoff=15.0, reach=REACH, **options)
    Y = one.regressor(between=True)
    rows = DriveRows(recording.log.torque_max, Y.shape[1])
    return one, rows, Span.of(rows.stack(Y))


@pytest.mark.parametrize("late", [-7.3e-3, 0.0, 0.6e-3, 13.1e-3])
def test_a_common_lag_is_found_with_an_interval_that_holds_it(late: float) -> None:
    one, rows, span = traced(frame(np.full(3, late)))
    start = coarse_lag(one, rows, span)
    assert start == pytest.approx(late, abs=3e-3)
    lag = estimate_lag(one, rows, span, np.full(3, start), common=True)
    assert np.ptp(lag.values) == 0
    assert lag.values[0] == pytest.approx(late, abs=1.5 * lag.interval[0])
    assert lag.interval[0] < 0.3e-3


def test_lags_of_drives_are_told_apart() -> None:
    late = np.array([2e-3, 2e-3, -1.5e-3])
    one, rows, span = traced(frame(late))
    lag = estimate_lag(one, rows, span, np.zeros(3), common=False)
    np.testing.assert_array_less(np.abs(lag.values - late), 1.5 * lag.interval)
    assert lag.interval.max() < 0.5e-3


def test_without_noise_a_lag_and_the_parameters_come_out() -> None:
    one, rows, span = traced(frame(np.full(3, 4e-3), noise=0.0))
    lag = estimate_lag(one, rows, span, np.zeros(3), common=True)
    assert lag.values[0] == pytest.approx(4e-3, abs=0.15e-3)  # steps fall between samples
    dynamics, p, motion = moving()
    z, zd, zdd = motion.evaluate(np.linspace(0, 4, 50))
    _, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    expected = dynamics.torque(z, qd, qdd, p)
    found = dynamics.torque(z, qd, qdd, lag.p)
    assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()


def test_a_step_of_friction_lies_between_samples() -> None:
    """Half of the filtered difference to the sampled step is on either side."""
    one, *_ = traced(frame(np.zeros(3)))
    between, sampled = one.regressor(between=True), one.regressor()
    changed = np.abs(between - sampled).max(axis=(0, 1))
    names = np.array(moving()[0].layout.names)
    active = names[np.unique(moving()[0].regressor_pattern[1])]
    stepping = np.array([name.startswith("coulomb") for name in active])
    size = np.abs(sampled).max(axis=(0, 1))
    assert np.all(changed[stepping] > 1e-3)
    assert np.all(changed[~stepping] < 1e-3 * size[~stepping])
    assert np.all(changed[stepping] < 0.1)


def test_torques_are_shifted_by_parts_of_a_sample() -> None:
    one, *_ = traced(frame(np.full(3, 2.7e-3), noise=0.0))
    straight, *_ = traced(frame(np.zeros(3), noise=0.0))
    back, right = one.torques(np.full(3, 2.7e-3)), straight.torques(np.zeros(3))
    assert np.abs(back - right).max() < 0.01 * np.abs(right).max()
    assert np.abs(one.torques(np.zeros(3)) - right).max() > 0.03 * np.abs(right).max()


def test_reversals_are_left_out_on_demand() -> None:
    with_them, *_ = traced(frame(np.zeros(3)))
    without, *_ = traced(frame(np.zeros(3)), reversals=False)
    kept = [np.mean(one.stretches[0].weights) for one in (with_them, without)]
    assert kept[1] < kept[0] - 0.02


def test_a_recording_that_is_too_short_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"too few|too short"):
        traced(frame(np.zeros(3)).head(200))


def test_of_a_long_log_a_few_runs_are_kept() -> None:
    dynamics, _, _ = moving()
    log = open_log(frame(np.zeros(3), rate=2000.0), dynamics.kinematics)  # three windows
    recording = with_filter(log, 15.0)
    load = prior_parameters(dynamics.robot)
    whole, some = (
        trace(dynamics, recording, load, cutoff=15.0, reach=0.0, windows=most) for most in (None, 2)
    )
    assert len(whole.stretches) == 1
    first, last = some.stretches
    assert first.time[0] == whole.stretches[0].time[0]
    assert last.time[-1] == whole.stretches[0].time[-1]
    assert len(first.time) + len(last.time) < 0.7 * len(whole.stretches[0].time)
