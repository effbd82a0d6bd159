"""Lags of torques and velocities as an identification corrects them; truth by evaluation."""

from functools import cache

import numpy as np
import polars as pl
import pytest
from scipy.signal import bilinear, lfilter

from deltaid.checks.identify import identify as checked
from deltaid.cli.options import lag_of
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.lag_columns import slope
from deltaid.effects.lag_groups import chosen_groups
from deltaid.effects.lags import Lags, estimate_lags
from deltaid.errors import DeltaidError
from deltaid.estimation.traces import trace
from deltaid.identification.column_stages import late_rate, late_rates_excluded
from deltaid.identification.identify import identify
from deltaid.identification.prediction import validate
from deltaid.identification.setup import Setup
from deltaid.identification.sources import model_filtered
from deltaid.joint_forces.ranges import evidence
from deltaid.model.corrections import Correction, Event
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.model.verdict import Grade
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from deltaid.recording.repairs import LeftSpan
from deltaid.robot.load import load_robot
from logs import tabled

RATE, DURATION, NOISE = 500.0, 9.0, 0.01
PLAIN = Settings(events=False, friction="described", effects="none")


@cache
def robot() -> tuple[Dynamics, np.ndarray]:
    dynamics = compiled(load_robot("clavel-delta3"))
    return dynamics, surrogate_parameters(dynamics.robot, np.random.default_rng(2))


def recorded(
    late: float | list[float],
    *,
    by_direction: float = 0.0,
    loop: float = 0.0,
    velocity: float | None = None,
    seed: int = 5,
    rate: float = RATE,
) -> pl.DataFrame:
    """A recording.

    Args:
        late: by how much torques come late, for all drives or each [s].
        by_direction: share of Coulomb friction that torques have more in one direction.
        loop: time constant of a filter on torques [s].
        velocity: by how much recorded velocities come late [s]; None for none recorded.
    """
    dynamics, p = robot()
    coulomb = p[dynamics.layout.coulomb][: dynamics.dof]
    rng, dof = np.random.default_rng(seed), dynamics.dof
    motion = random_motion(dynamics.kinematics, rng, period=3.917)
    t = np.arange(round(DURATION * rate)) / rate

    def motion_at(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        z, zd, zdd = motion.evaluate(time)
        q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
        tau = dynamics.torque(z, qd, qdd, p) + by_direction * coulomb * (qd > 0)
        return q, qd, tau

    q, _, _ = motion_at(t)
    delays = np.broadcast_to(late, dof)
    if loop:  # ∫ τ(t − s) e^(−s/T) ds / T, as a sum of shares of its area
        edges = -loop * np.log1p(-np.linspace(0, 1, 33)[:-1] - 1 / 64)
        parts = [motion_at(t - edge)[2] for edge in edges]
        tau = np.mean(parts, axis=0)
    else:
        tau = np.column_stack([motion_at(t - delay)[2][:, i] for i, delay in enumerate(delays)])
    tau = tau + NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    rates = {} if velocity is None else {"qd": motion_at(t - velocity)[1]}
    return tabled(t=t, q=1e-6 * np.round(1e6 * q), **rates, tau=tau)


def estimated(*tables: pl.DataFrame) -> Lags:
    dynamics, _ = robot()
    prior = prior_parameters(dynamics.robot)
    held = [
        trace(dynamics, recording, prior, cutoff=recording.cutoff)
        for recording in open_recordings(tables, dynamics.kinematics)
    ]
    return estimate_lags(held, spread=0.5)


@pytest.mark.parametrize("late", [[2.3e-3] * 3, [-9.6e-3] * 3, [1.3e-3, -3.1e-3, 14.7e-3]])
def test_lags_come_out_to_a_small_part_of_a_sample(late: list[float]) -> None:
    lags = estimated(recorded(late))
    deviation = np.sqrt(np.diag(lags.covariance[0]))
    assert np.all(np.abs(lags.values[0] - late) < np.maximum(4 * deviation, 2e-5))
    assert np.all(np.abs(lags.values[0] - late) < 1.2e-4)
    assert np.all(np.isfinite(lags.step_std))


def test_friction_by_direction_looks_like_a_lag_but_not_where_drives_turn_round() -> None:
    lags = estimated(recorded(1.1e-3, by_direction=1.2))
    np.testing.assert_allclose(lags.values[0], 1.1e-3, atol=1.2e-4)
    assert np.all(np.isfinite(lags.step_std))


def test_a_filter_of_the_drive_counts_as_lag() -> None:
    lags = estimated(recorded(0.0, loop=3e-3))
    np.testing.assert_allclose(lags.values[0], 3e-3, atol=4e-4)
    np.testing.assert_allclose(lags.steps[0], 3e-3, atol=3e-4)  # as reversals alone tell it
    assert np.all(np.isfinite(lags.step_std))


def test_a_filter_of_second_order_is_a_lag_whatever_the_law_of_friction() -> None:
    """Its steps fit no filter of first order, and by direction friction looks like a lag."""
    table, w = recorded(0.0, by_direction=1.2), 2 * np.pi * 60.0
    b, a = bilinear([w * w], [1.0, 1.4 * w, w * w], RATE)
    tau = table["tau1"].to_numpy()
    table = table.with_columns(tau1=pl.Series(lfilter(b, a, tau - tau[0]) + tau[0]))
    lags = estimated(table)
    assert not np.isfinite(lags.step_std[0, 0])
    steps, deviation = lags.steps[0, 0], np.sqrt(lags.covariance[0, 0, 0])
    assert 2 * lags.values[0, 0] - steps == pytest.approx(1.4 / w, abs=2.5e-4)  # beside any law
    assert abs(lags.values[0, 0] - 1.4 / w) < 2 * deviation
    (group,) = lags.groups(0)
    assert group.drives == (0,)


def test_groups_are_as_few_as_scatter_allows() -> None:
    covariance = np.diag(np.array([2e-5, 3e-5, 2e-5, 6e-4]) ** 2)

    def groups(*lags: float) -> tuple[tuple[int, ...], ...]:
        return tuple(group.drives for group in chosen_groups(np.array(lags), covariance))

    assert groups(1e-5, -3e-5, 2e-5, 9e-4) == ()
    assert groups(2.01e-3, 1.98e-3, 2e-3, 2.7e-3) == ((0, 1, 2, 3),)
    assert groups(2.01e-3, 1.98e-3, 2e-3, -1.9e-3) == ((0, 1, 2), (3,))
    assert groups(0.0, 0.0, 1e-3, -3e-3) == ((2,), (3,))
    assert groups(1e-3, 2e-3, 3e-3, 4e-2) == ((0,), (1,), (2,), (3,))
    (alike,) = chosen_groups(np.array([2e-3, 2.03e-3, 2e-3, 2.9e-3]), covariance)
    assert alike.delay == pytest.approx(2.006e-3, abs=1e-5)


def test_the_slope_of_torques_has_no_steps() -> None:
    t = np.linspace(0, 1, 101)
    tau = np.vstack([3 * t + np.where(t > 0.405, 5.0, 0.0), t**2])
    turned = np.zeros((2, 100), dtype=bool)
    turned[0, 40] = True
    found = 100 * slope(tau, turned)
    np.testing.assert_allclose(found[0], 3.0, atol=1e-9)
    np.testing.assert_allclose(found[1, 1:-1], 2 * t[1:-1], atol=1e-9)


@cache
def late_model() -> IdentifiedModel:
    return identify(robot()[0].robot, recorded(2.3e-3), settings=PLAIN).model


def test_a_lag_is_corrected_reported_and_kept() -> None:
    model, (dynamics, p) = late_model(), robot()
    (lag_correction,) = [correction for correction in model.corrections if correction.kind == "lag"]
    assert lag_correction.subject == ""
    assert lag_correction.unit == "s"
    assert lag_correction.value == pytest.approx(2.3e-3, abs=5e-5)
    assert lag_correction.low < 2.3e-3 < lag_correction.high
    assert lag_correction.high - lag_correction.low < 2e-4
    assert model.sources[0].delay == pytest.approx((2.3e-3,) * 3, abs=5e-5)
    assert len(model.parameters) == len(p)
    q = np.zeros((1, 3))
    np.testing.assert_allclose(
        dynamics.mass_matrix(q, model.p), dynamics.mass_matrix(q, p), rtol=3e-3, atol=2e-5
    )
    for kind in (dynamics.layout.viscous, dynamics.layout.coulomb):
        np.testing.assert_allclose(model.p[kind][:3], p[kind][:3], rtol=0.02)


def test_an_identification_without_correction_is_worse_and_says_nothing_of_one() -> None:
    dynamics, p = robot()
    model = identify(dynamics.robot, recorded(2.3e-3), settings=PLAIN.changed(lag="none")).model
    assert not model.corrections
    q = np.zeros((1, 3))
    error = dynamics.mass_matrix(q, model.p) / dynamics.mass_matrix(q, p) - 1
    assert np.abs(np.diag(error[0])).max() > 5e-3


def test_another_recording_is_compared_with_the_lag_of_the_model() -> None:
    other = recorded(2.3e-3, seed=6)
    log = open_log(other, robot()[0].kinematics)
    assert model_filtered(late_model(), log).repairs.delay == late_model().sources[0].delay
    error, _ = validate(late_model(), other)
    straight, _ = validate(late_model(), recorded(0.0, seed=6))
    assert np.all(error.rms < 0.6 * straight.rms)


def test_forces_are_judged_with_the_lag_of_the_model() -> None:
    given, _ = evidence(late_model(), recorded(2.3e-3))
    untold = late_model().changed(
        sources=tuple(source.changed(delay=()) for source in late_model().sources)
    )
    wrong, _ = evidence(untold, recorded(2.3e-3))
    assert wrong.estimate.noise.sigma > 2 * given.estimate.noise.sigma


def test_what_was_excluded_is_excluded_from_the_same_recording_again() -> None:
    push = Event(reason="contact", start=2.0, end=2.1, drives=("drive1", "drive3"))
    model = late_model()
    model = model.changed(sources=(model.sources[0].changed(events=(push,)),))
    kinematics = robot()[0].kinematics
    same, other = (open_log(recorded(2.3e-3, seed=seed), kinematics) for seed in (5, 6))
    assert model_filtered(model, same).repairs.left_out == (LeftSpan(2.0, 2.1, "contact", (0, 2)),)
    assert not model_filtered(model, other).repairs.left_out


def test_a_lag_that_is_given_is_applied_as_it_is() -> None:
    dynamics, _ = robot()
    table = recorded([1e-3, 1e-3, 4e-3])
    result = identify(dynamics.robot, table, settings=PLAIN.changed(lag=(1e-3, 1e-3, 4e-3)))
    assert result.recordings[0].repairs.delay == (1e-3, 1e-3, 4e-3)
    assert [correction.value for correction in result.model.corrections] == [1e-3, 1e-3, 4e-3]
    assert not result.problem.additions
    with pytest.raises(DeltaidError, match="has 2 values, and the robot has 3 drives"):
        identify(dynamics.robot, table, settings=PLAIN.changed(lag=(1e-3, 2e-3)))


def test_each_recording_has_its_own_lag() -> None:
    lags = estimated(recorded(2.3e-3), recorded(-0.9e-3, seed=6))
    np.testing.assert_allclose(lags.values, np.outer([2.3e-3, -0.9e-3], np.ones(3)), atol=1.2e-4)


def test_what_the_option_takes() -> None:
    assert lag_of("estimate") == "estimate"
    assert lag_of("none") == "none"
    assert lag_of("2") == (2e-3,)
    assert lag_of("2,-1.5,0") == pytest.approx((2e-3, -1.5e-3, 0.0))
    for wrong in ("two", "2;3", "", "500", "nan"):
        with pytest.raises(DeltaidError, match="--lag"):
            lag_of(wrong)


@pytest.mark.parametrize("late", [0.0, 2e-3, -1e-3])
def test_velocities_that_lag_are_excluded(late: float) -> None:
    dynamics, _ = robot()
    (recording,) = open_recordings(recorded(0.0, velocity=late), dynamics.kinematics)
    found = late_rate(recording, dynamics.kinematics)
    setup = late_rates_excluded(Setup(dynamics.robot, (recording,), Settings()), lambda _: None)
    left = setup.recordings[0]
    if late == 0.0:
        assert found is None
        assert left is recording
        assert not setup.corrections
        return
    np.testing.assert_allclose(found.values, late, rtol=0.01)
    assert not left.log.columns.velocity
    assert left.cutoff == recording.cutoff
    (correction,) = setup.corrections
    assert correction.kind == "velocity"
    assert correction.value == pytest.approx(late, rel=0.01)


def test_columns_that_have_been_excluded_are_not_complained_about() -> None:
    judged = checked(robot()[0].robot, [recorded(0.0, velocity=2e-3)])
    (velocity_verdict,) = (verdict for verdict in judged.verdicts if verdict.key == "velocity")
    assert velocity_verdict.grade is Grade.GOOD
    assert "excluded" in velocity_verdict.seen
    assert not any("velocit" in text for text in judged.model.warnings)


def test_a_model_of_late_velocities_leaves_them_out_of_comparisons() -> None:
    correction = Correction(kind="velocity", value=2e-3, unit="s", text="they come late")
    model = late_model().changed(corrections=(correction,))
    other = open_log(recorded(0.0, velocity=2e-3, seed=6), robot()[0].kinematics)
    assert not model_filtered(model, other).log.columns.velocity
    assert model_filtered(late_model(), other).log.columns.velocity
