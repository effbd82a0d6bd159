"""The lag between torques and positions, drive by drive, and torques put back beside the motion."""

from dataclasses import replace
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
from deltaid.recording.columns import Channel, Columns, TimeChannel
from deltaid.recording.delay import Shift, delayed
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.load import load_robot
from logs import tabled

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

    def motion_at(time: np.ndarray) -> tuple[np.ndarray, ...]:
        z, zd, zdd = motion.evaluate(time)
        q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
        return q, dynamics.torque(z, qd, qdd, p)

    q, _ = motion_at(t)
    tau = np.stack([motion_at(t - lag)[1][:, i] for i, lag in enumerate(late)], axis=1)
    rng = np.random.default_rng(3)
    tau += noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    return tabled(t=t, q=1e-6 * np.round(1e6 * q), tau=tau)


def traced(table: pl.DataFrame) -> Trace:
    dynamics, _, _ = moving()
    recording = with_filter(open_log(table, dynamics.kinematics), 15.0)
    return trace(dynamics, recording, prior_parameters(dynamics.robot), cutoff=15.0)


def test_white_noise_is_smaller_by_the_share_of_samples_that_count() -> None:
    record, rng = traced(frame(np.zeros(3))), np.random.default_rng(1)
    (run,) = record.stretches
    spans = np.repeat(rng.uniform(size=(len(run.time) // 50 + 1, 3)), 50, axis=0)[: len(run.time)]
    weights = np.where(spans < [1.0, 0.7, 0.3], 1.0, [1.0, 0.5, 0.0])
    squares = []
    for _ in range(40):
        part = replace(run, tau=rng.standard_normal(run.tau.shape), weights=weights)
        partly = replace(record, stretches=(part,))
        squares.append(np.mean((partly.torques() / record.low_pass.noise_gain) ** 2, axis=1))
    assert np.mean(squares, axis=0) == pytest.approx(partly.counted, rel=0.1)
    assert partly.counted == pytest.approx([1.0, 0.775, 0.3], abs=0.06)


def searched_lags(table: pl.DataFrame) -> Lags:
    """With a wide prior: a surrogate's parameters are far from it."""
    return estimate_lags([traced(table)], spread=1.0)


@pytest.mark.parametrize("late", [-7.3e-3, 0.0, 0.6e-3, 13.1e-3])
def test_a_common_lag_is_found_with_an_interval_that_holds_it(late: float) -> None:
    lag = searched_lags(frame(np.full(3, late))).common(0)
    assert np.ptp(lag.values) == 0
    assert lag.values[0] == pytest.approx(late, abs=1.5 * lag.interval[0])
    assert lag.interval[0] < 0.3e-3


def test_lags_of_drives_are_distinguished() -> None:
    late = np.array([2e-3, 2e-3, -1.5e-3])
    lag = searched_lags(frame(late)).each(0)
    np.testing.assert_array_less(np.abs(lag.values - late), 1.5 * lag.interval)
    assert lag.interval.max() < 0.5e-3


def test_a_common_lag_is_the_mean_by_generalised_least_squares() -> None:
    rng = np.random.default_rng(0)
    root, values = rng.standard_normal((3, 3)), rng.standard_normal(3)
    C = root @ root.T
    nothing = np.zeros((1, 3))
    lags = Lags(values[None], C[None], *[nothing] * 2, *[nothing > 0] * 2, nothing, np.zeros(0))
    inverse = np.linalg.inv(C)
    lag = lags.common(0)
    np.testing.assert_allclose(lag.values, inverse.sum(axis=0) @ values / inverse.sum())
    np.testing.assert_allclose(lag.deviation, inverse.sum() ** -0.5)
    np.testing.assert_allclose(lags.each(0).deviation, np.sqrt(np.diag(C)))
    np.testing.assert_allclose(lag.interval, stats.t.ppf(0.975, STRETCHES - 1) * lag.deviation)


def test_without_noise_a_lag_and_the_parameters_come_out() -> None:
    lag = searched_lags(frame(np.full(3, 4e-3), noise=0.0))
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

    def off(torque_trace: Trace) -> float:
        """What the true parameters leave of the torques, as a share."""
        left = torque_trace.torques() - torque_trace.model(p)
        return float(np.abs(left).max() / np.abs(torque_trace.torques()).max())

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


def columns(drives: int, *, velocity: bool = False) -> Columns:
    def channels(name: str) -> tuple[Channel, ...]:
        return tuple(Channel(f"{name}{i}", 1.0, 0.0) for i in range(drives))

    only = Columns(TimeChannel("t", 1.0, 0.0), channels("q"), (), (), channels("tau"))
    return replace(only, velocity=channels("qd")) if velocity else only


def waves(rate: float, late: np.ndarray, seconds: float = 2.0) -> np.ndarray:
    """Rows of t, q, q̇, torques that come late, and weights; torques are 3 q + 2 q̇ of their time."""
    t, dof = np.arange(round(seconds * rate)) / rate, len(late)
    turns = 2 * np.pi * (1.0 + 0.7 * np.arange(dof))

    def waves_at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(turns * time), turns * np.cos(turns * time)

    q, qd = waves_at(t[:, None])
    early = waves_at(t[:, None] - late)
    return np.hstack([t[:, None], q, qd, 3 * early[0] + 2 * early[1], np.ones((len(t), dof))])


def put_right(rows: np.ndarray, late: np.ndarray, rate: float, cuts: list[int]) -> np.ndarray:
    blocks = iter(np.split(rows, cuts))
    kinds = columns(len(late), velocity=True)
    return np.vstack([*delayed(blocks, kinds, Shift.of_delays(late.tolist(), rate), rate)])


@pytest.mark.parametrize("rate", [100.0, 1000.0, 10_000.0])
@pytest.mark.parametrize(
    "late",
    [[7.3e-3] * 3, [-10e-3] * 3, [20e-3] * 3, [2e-3, 2e-3, -1.5e-3], [0.11e-3, -4.4e-3, 3.37e-3]],
)
def test_torques_stand_beside_their_motion(rate: float, late: list[float]) -> None:
    rows = put_right(waves(rate, np.array(late)), np.array(late), rate, [31, 32, 90])
    _, q, qd, tau, weights = np.split(rows, [1, 4, 7, 10], axis=1)
    error = np.where(weights > 0, tau - 3 * q - 2 * qd, 0.0)
    assert np.abs(error).max() < 2e-4 * np.abs(tau).max()
    turns = 2 * np.pi * (1.0 + 0.7 * np.arange(3))
    np.testing.assert_allclose(q[9:-9], np.sin(turns * rows[9:-9, :1]), atol=1e-6)
    lost = np.count_nonzero(weights == 0, axis=0)
    assert np.all(lost >= np.floor(np.abs(late) * np.array(rate) + 1e-9))
    assert np.all(lost <= np.ceil(np.abs(late) * np.array(rate)) + 8)


def test_rows_do_not_depend_on_how_they_are_cut() -> None:
    late, rng = np.array([1.3e-3, -0.4e-3, 6e-3]), np.random.default_rng(0)
    rows = rng.standard_normal((25_000, 13))
    rows[:, -3:] = rng.uniform(size=(25_000, 3)) < 0.9
    whole = put_right(rows, late, 1000.0, [])
    some = np.sort(rng.integers(0, 25_000, 400)).tolist()
    np.testing.assert_array_equal(put_right(rows, late, 1000.0, some), whole)
    assert len(whole) == len(rows)


def test_a_common_lag_leaves_every_torque_as_it_was_recorded() -> None:
    """And moves it by whole samples: a jump stays one."""
    rows = waves(1000.0, np.zeros(2), 0.1)
    rows[:, 5:7] = np.sign(np.arange(100) - 49.5)[:, None]
    out = put_right(rows, np.full(2, 2.4e-3), 1000.0, [])
    np.testing.assert_array_equal(out[:-2, 5:7], rows[2:, 5:7])
    np.testing.assert_allclose(out[:, 0], rows[:, 0] - 0.4e-3, atol=1e-12)
    np.testing.assert_allclose(out[20:80, 1], np.sin(2 * np.pi * out[20:80, 0]), atol=1e-9)


def test_of_drives_that_differ_as_few_as_can_be_are_interpolated() -> None:
    shift = Shift.of_delays([2.4e-3, -0.6e-3, 2.4e-3, 1.0e-3], 1000.0)
    assert shift.whole == (2, -1, 2, 1)
    np.testing.assert_allclose(shift.common, 0.4)
    np.testing.assert_allclose(shift.rest, [0, 0, 0, -0.4], atol=1e-9)
    assert shift.smear == (0, 0, 0, 2)


def test_the_weight_is_the_least_of_the_rows_own_and_of_those_that_a_torque_is_made_of() -> None:
    rows = waves(1000.0, np.zeros(2), 0.1)
    rows[50, -2:], rows[60, -1] = 0.0, 0.3
    whole = put_right(rows, np.array([3e-3, 3e-3]), 1000.0, [])
    assert np.flatnonzero(whole[:-3, -2] == 0).tolist() == [47, 50]
    assert np.flatnonzero(whole[:, -1] == 0.3).tolist() == [57, 60]
    parted = put_right(rows, np.array([3e-3, 0.5e-3]), 1000.0, [])
    assert np.flatnonzero(parted[3:-3, -1] == 0).tolist() == [45, 46, 47, 48]
    assert np.all(whole[-3:, -2:] == 0)
    assert np.all(whole[:47, -2:] == 1)


def test_without_a_lag_nothing_changes() -> None:
    rows = waves(500.0, np.zeros(3))
    np.testing.assert_array_equal(put_right(rows, np.zeros(3), 500.0, [100]), rows)


def test_a_segment_shorter_than_the_lag_counts_for_nothing() -> None:
    rows = waves(1000.0, np.zeros(2), 0.004)
    out = put_right(rows, np.full(2, 9.5e-3), 1000.0, [1])
    assert len(out) == 4
    assert np.all(out[:, -2:] == 0)
    assert [*delayed(iter([]), columns(2), Shift.of_delays((1e-3, 1e-3), 1000.0), 1000.0)] == []
