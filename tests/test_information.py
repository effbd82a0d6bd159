"""Information factors and base parameters against plain dense least squares."""

from itertools import pairwise

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.base_parameters import base_parameters
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.information import Information, gather_samples, merge
from deltaid.identification.gathering import gather, places_of
from deltaid.identification.generic_motion import random_motion_base
from deltaid.identification.least_squares import estimate_base, identify_base
from deltaid.identification.torque_error import torque_error
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.recording.opening import open_log
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.robot.load import load_robot
from support import along, assert_close

ROBOT = "irb360-6-1600"


def samples(name: str = ROBOT, n: int = 900, seed: int = 0) -> tuple[np.ndarray, ...]:
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(seed)
    z, _, qd, qdd = along(dynamics.kinematics, rng, n)
    truth = surrogate_parameters(dynamics.robot, rng)
    tau = dynamics.torque(z, qd, qdd, truth)
    return z, qd, qdd, tau + rng.standard_normal(tau.shape)


def recorded(
    seed: int, *, as_described: bool = False, **how
) -> tuple[Dynamics, np.ndarray, pl.DataFrame]:
    """A robot, its parameters, and a recording of it."""
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(seed)
    robot = dynamics.robot
    p = prior_parameters(robot) if as_described else surrogate_parameters(robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    return dynamics, p, simulate_recording(dynamics, p, motion, rng, **how)


def dense(name: str, data: tuple[np.ndarray, ...]) -> np.ndarray:
    dynamics = compiled(load_robot(name))
    z, qd, qdd, _ = data
    return dynamics.regressor(dynamics.kinematics.inverse(z), qd, qdd)


def gathered() -> tuple[Dynamics, tuple[np.ndarray, ...], Information]:
    """A robot, samples, and what is gathered of them."""
    dynamics, data = compiled(load_robot(ROBOT)), samples()
    return dynamics, data, gather_samples(dynamics, *data)


def grams(information: Information) -> np.ndarray:
    """FᵀF of each drive's factor F."""
    return np.swapaxes(information.factors, 1, 2) @ information.factors


def test_factor_is_the_factor_of_the_dense_regressor() -> None:
    _, data, information = gathered()
    Y, weights = dense(ROBOT, data), np.array([0.5, 1.0, 2.0, 30.0])
    A = np.concatenate([Y[:, :, information.columns], data[3][:, :, None]], axis=2)
    A = (A * np.sqrt(weights)[None, :, None]).reshape(-1, A.shape[2])
    F = information.weighted(weights)
    assert_close(F.T @ F, A.T @ A, 1e-10)


def test_information_adds_up_over_parts() -> None:
    dynamics, data = compiled(load_robot(ROBOT)), samples(n=903)
    whole = gather_samples(dynamics, *data)
    cuts = [0, 7, 400, 903]
    pieces = [gather_samples(dynamics, *(x[a:b] for x in data)) for a, b in pairwise(cuts)]
    together = merge(pieces)
    np.testing.assert_array_equal(together.samples, whole.samples)
    assert np.allclose(together.torque_max, whole.torque_max)
    a, b = (each.weighted(np.ones(4)) for each in (together, whole))
    assert_close(a.T @ a, b.T @ b, 1e-10)


def test_rms_from_the_factor_is_the_rms_of_the_samples() -> None:
    dynamics, data, information = gathered()
    p = np.random.default_rng(3).standard_normal(len(dynamics.layout.names))
    error = data[3] - dense(ROBOT, data) @ p
    assert np.allclose(information.rms(p), np.sqrt(np.mean(error**2, axis=0)), rtol=1e-9)
    assert np.allclose(information.torque_rms(), np.sqrt(np.mean(data[3] ** 2, axis=0)))


def test_a_singular_sample_is_an_error_and_not_a_number() -> None:
    dynamics, data = compiled(load_robot(ROBOT)), samples()
    data[0][5] = np.nan
    with pytest.raises(IdentificationError, match="not finite"):
        gather_samples(dynamics, *data)


@pytest.mark.parametrize(("name", "rank"), [("irb360-6-1600", 37), ("clavel-delta3", 18)])
def test_base_parameters_explain_every_torque_of_another_motion(name: str, rank: int) -> None:
    dynamics = compiled(load_robot(name))
    base = random_motion_base(dynamics, seed=1)
    assert base.rank == rank
    data = samples(name, n=50, seed=9)
    Y = dense(name, data)
    heads = [group.representative for group in base.groups]
    p = np.random.default_rng(0).standard_normal(Y.shape[2])
    assert np.allclose(Y @ p, Y[:, :, heads] @ (base.combination() @ p), atol=1e-9)


def test_groups_do_not_depend_on_the_motion() -> None:
    dynamics = compiled(load_robot(ROBOT))
    a, b = random_motion_base(dynamics, seed=1), random_motion_base(dynamics, seed=2)
    assert a.formulas == b.formulas
    assert np.allclose(a.combination(), b.combination(), atol=1e-7)


def test_formulas_read_as_the_mechanism_says() -> None:
    base = random_motion_base(compiled(load_robot(ROBOT)))
    formulas = base.formulas
    assert "m_P + 5.08475·mcx_S + m_TL + m_EE" in formulas  # 6 struts, mass at 1/1.18 m
    assert "Izz_EE + rotor.drive4" in formulas
    assert "Ixx_TL + Ixx_TU" in formulas
    assert base.layout.parameters[base.layout.names.index("S.mcx")].label == "mcx_S"


def test_equal_coefficients_are_factored() -> None:
    from deltaid.estimation.base_parameters import BaseGroup

    layout = compiled(load_robot(ROBOT)).layout
    at = {name: i for i, name in enumerate(layout.names)}
    group = BaseGroup(at["P.m"], {at["S.m"]: 6.0, at["S.mcx"]: -6.0, at["EE.m"]: -1.0})
    assert group.formula(layout) == "m_P + 6·(m_S − mcx_S) − m_EE"


def test_a_motion_of_one_drive_only_determines_less() -> None:
    dynamics = compiled(load_robot("clavel-delta3"))
    q = np.zeros((200, 3))
    q[:, 0] = 0.3 * np.sin(np.linspace(0, 6, 200))
    qd, qdd = np.gradient(q, axis=0), np.gradient(np.gradient(q, axis=0), axis=0)
    z = dynamics.kinematics.forward(q)
    information = gather_samples(dynamics, z, qd, qdd, np.ones_like(q))
    assert base_parameters(information, dynamics.layout).rank < 18


@pytest.mark.parametrize("method", ["ordinary", "weighted"])
def test_least_squares_and_deviations_are_the_textbooks(method) -> None:
    dynamics, data, information = gathered()
    base = base_parameters(information, dynamics.layout)
    estimate = estimate_base(base, information, method)
    heads = [group.representative for group in base.groups]
    w = np.ones(4) if method == "ordinary" else 1 / np.abs(data[3]).max(axis=0)
    A = (dense(ROBOT, data)[:, :, heads] * w[None, :, None]).reshape(-1, base.rank)
    b = (data[3] * w).ravel()
    values, rss, *_ = np.linalg.lstsq(A, b, rcond=None)
    scale = np.linalg.norm(A, axis=0)
    covariance = np.linalg.inv((A / scale).T @ (A / scale)) / np.outer(scale, scale)
    std = np.sqrt(rss[0] / (len(b) - base.rank) * np.diag(covariance))
    assert np.allclose(estimate.values, values, rtol=1e-6, atol=1e-6 * std.min())
    assert np.allclose(estimate.std, std, rtol=1e-6)


def test_standard_deviations_are_those_of_repeated_noise() -> None:
    dynamics, data = compiled(load_robot("clavel-delta3")), samples("clavel-delta3", n=300)
    base = random_motion_base(dynamics)
    rng, scores = np.random.default_rng(0), []
    truth = base.combination() @ surrogate_parameters(dynamics.robot, np.random.default_rng(4))
    full = np.zeros(len(dynamics.layout.names))
    full[[group.representative for group in base.groups]] = truth
    clean = dynamics.torque(*data[:3], full)
    for _ in range(60):
        noisy = gather_samples(dynamics, *data[:3], clean + rng.standard_normal(clean.shape))
        estimate = estimate_base(base, noisy, "ordinary")
        scores.append((estimate.values - truth) / estimate.std)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.06)


def test_gauss_markov_is_the_tighter_one_when_drives_differ() -> None:
    dynamics, truth, recording = recorded(0, noise=SensorNoise(torque=0.0))
    noise = np.random.default_rng(1).standard_normal((recording.height, 3)) * [3.0, 0.1, 0.1]
    noise[:, 1] += 0.5 * noise[:, 0]  # correlated between drives
    for i in range(3):
        recording = recording.with_columns(recording[f"tau{i + 1}"] + noise[:, i])
    true_base, errors, stds = None, {}, {}
    for method in ("ordinary", "weighted", "gauss-markov"):
        base, estimate = identify_base(dynamics, recording, method)
        true_base = base.combination() @ truth
        errors[method] = np.abs(estimate.values - true_base) / np.abs(true_base).max()
        stds[method] = estimate.std
    assert np.median(stds["gauss-markov"] / stds["ordinary"]) < 0.5
    assert np.sum(errors["gauss-markov"]) < np.sum(errors["ordinary"])


def test_filtered_information_agrees_with_the_streamed_torque_error() -> None:
    dynamics, truth, recording = recorded(0, noise=SensorNoise())
    prepared = with_filter(open_log(recording, dynamics.kinematics))
    information = merge(gather(dynamics, prepared))
    streamed = torque_error(dynamics, truth, prepared)
    # The information is thinned, the stream is not, so the two are estimates of the same number.
    assert np.allclose(information.rms(truth), streamed.rms, rtol=0.1)
    largest = np.abs(recording.select(["tau1", "tau2", "tau3"]).to_numpy()).max(axis=0)
    assert np.allclose(streamed.rms_unfiltered, 0.02 * largest, rtol=0.25)


def test_blocks_of_a_log_are_consecutive_equal_and_together_the_whole():
    dynamics, _, recording = recorded(3, as_described=True, duration=20.3, rate=997.0)
    log = open_log(recording, dynamics.kinematics, None, keep_all=True)
    blocks = gather(dynamics, PreparedRecording(log, None))
    length = -(-log.samples // STRETCHES)
    assert [b.mean_samples for b in blocks[:-1]] == [length] * (len(blocks) - 1)
    assert sum(b.mean_samples for b in blocks) == log.samples
    values = recording.to_numpy()
    third = values[2 * length : 3 * length]
    q, qd, qdd, tau = np.split(third[:, 1:], 4, axis=1)
    z = dynamics.kinematics.forward(q)
    alone = gather_samples(dynamics, z, qd, qdd, tau)
    for gram, expected in zip(grams(blocks[2]), grams(alone), strict=True):
        assert_close(gram, expected, 1e-9)


@pytest.mark.parametrize("filtered", [False, True])
def test_places_divide_the_same_samples_by_where_the_platform_was(filtered):
    dynamics, _, recording = recorded(4, as_described=True, duration=20.0)
    log = open_log(recording, dynamics.kinematics, None, keep_all=True)
    prepared = with_filter(log, 20.0 if filtered else None)
    places = places_of(dynamics, [prepared])
    whole = merge(gather(dynamics, prepared, places))
    assert_close(places.sums.sum(axis=0), grams(whole), 1e-9)
    if filtered:
        return
    q, qd, qdd, tau = np.split(recording.to_numpy()[:, 1:], 4, axis=1)
    z = dynamics.kinematics.forward(q)
    part = np.floor((z - z.min(axis=0)) / np.ptp(z, axis=0) * (3 - 1e-12)).astype(int)
    middle = np.all(part == 1, axis=1)
    assert 100 < middle.sum() < len(z) / 2
    alone = gather_samples(dynamics, z[middle], qd[middle], qdd[middle], tau[middle])
    assert_close(places.sums[1 + 3 + 9], grams(alone), 1e-9)


@pytest.mark.parametrize("method", ["ordinary", "weighted", "gauss-markov"])
def test_every_method_has_intervals_from_the_scatter(method) -> None:
    dynamics, truth, recording = recorded(5, duration=20.0, noise=SensorNoise())
    base, estimate = identify_base(dynamics, recording, method)
    assert estimate.noise.groups in ("time", "place")
    assert np.all(estimate.interval > 1.96 * estimate.std)
    within = np.abs(estimate.values - base.combination() @ truth) <= estimate.interval
    assert within.mean() > 0.8
