"""What is estimated while a robot runs: how it is forgotten, what numbers tell of it, its prior,
and noise of speeds."""

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import stated_spreads
from deltaid.model.model import load
from deltaid.online.cycle import of_speeds
from deltaid.online.kalman import Estimate, States
from deltaid.online.momentum import Lowpass, build_momentum
from deltaid.online.settings import OnlineKnowledge, OnlineSettings, knowledge
from deltaid.robot.load import load_robot
from picking import picked
from shuttling import ENCODER, RATE, shuttle
from support import along

PRIOR = np.array([1.0, 0.0, 1.0, 4.0])
MEANS, WANDERS = np.array([0.7, -0.2, 1.5, -3.0]), np.array([0.0, 1.0, 0.0, 1.0])


def covariance(seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).uniform(-0.4, 0.4, (4, 4))
    return root @ root.T


def numbers(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    return np.array(ca.evalf(estimate.x)).ravel(), np.array(ca.evalf(estimate.P))


def forgotten(P: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance a cycle later."""
    start = Estimate(ca.SX(MEANS), ca.SX(P))
    return numbers(start.forgotten(ca.SX(kept), ca.SX(PRIOR), ca.SX(WANDERS)))


def test_states_at_their_prior_stay_there() -> None:
    """The noise of x' = φ x + w is what the stationary variance of the prior needs."""
    _, P = forgotten(np.diag(PRIOR), np.array([0.3, 0.5, 0.8, 0.99]))
    np.testing.assert_allclose(P, np.diag(PRIOR), atol=1e-15)


def test_many_cycles_are_one_long_one() -> None:
    """As of Ornstein and Uhlenbeck's process, sampled: what is remembered after a time does not
    depend on the cycles that it is cut into."""
    kept, P = np.array([0.9, 0.8, 0.7, 0.95]), covariance()
    estimate = Estimate(ca.SX(MEANS), ca.SX(P))
    for _ in range(5):
        estimate = estimate.forgotten(ca.SX(kept), ca.SX(PRIOR), ca.SX(WANDERS))
    x, found = numbers(estimate)
    once_x, once = forgotten(P, kept**5)
    np.testing.assert_allclose(found, once, atol=1e-14)
    np.testing.assert_allclose(x, once_x, atol=1e-14)
    np.testing.assert_allclose(x, np.where(WANDERS == 1, kept**5, 1.0) * MEANS, atol=1e-14)


def test_all_is_forgotten_in_the_end() -> None:
    _, P = forgotten(covariance(), np.full(4, 1e-9))
    np.testing.assert_allclose(P, np.diag(PRIOR), atol=1e-15)


@pytest.mark.parametrize("weight", [1.0, 0.3, 0.0])
def test_a_number_tells_what_the_normal_distribution_says(weight: float) -> None:
    """By inverse covariances, of which a share of what it tells counts."""
    P, h, y, variance = covariance(1), np.array([[0.5, -1.0, 0.0, 2.0]]), 1.3, 0.04
    start = Estimate(ca.SX(MEANS), ca.SX(P))
    found, update = start.measured(ca.SX(h), ca.SX(y), ca.SX(variance), ca.SX(weight))
    information = np.linalg.inv(P) + weight * h.T @ h / variance
    right = np.linalg.solve(P, MEANS) + weight * h[0] * y / variance
    x, after = numbers(found)
    np.testing.assert_allclose(after, np.linalg.inv(information), atol=1e-12)
    np.testing.assert_allclose(x, np.linalg.solve(information, right), atol=1e-12)
    np.testing.assert_array_equal(after, after.T)
    assert float(update.innovation) == pytest.approx(weight * (y - h[0] @ MEANS))
    assert float(update.variance) == pytest.approx(weight * (h @ P @ h.T)[0, 0] + variance)
    if weight:
        moved = np.array(ca.evalf(update.gain)).ravel() * (y - h[0] @ MEANS)
        np.testing.assert_allclose(x - MEANS, moved, atol=1e-12)


def test_each_kind_of_state_has_its_own_memory() -> None:
    """What is known exactly is uncertain by 1 − e^(−2 t/T) after t: of a load that is held for ever
    known, of the model after 300 s, of friction as is asked for, of torques it has not 50 ms."""
    period, friction = 0.002, 20.0

    def later(held: float) -> np.ndarray:
        states, known = States(np.arange(4), period, friction), ca.SX.zeros(4, 4)
        return np.diag(numbers(states.later(Estimate(ca.SX.zeros(4), known), ca.SX(held)))[1])

    memory = np.array([np.inf, 300.0, friction, 0.05])
    np.testing.assert_allclose(later(1.0), -np.expm1(-2 * period / memory), rtol=1e-6)
    assert later(0.0)[0] == 0.0


@pytest.fixture(scope="module")
def known() -> OnlineKnowledge:
    return knowledge(load("irb360-6-1600"), OnlineSettings(largest_mass=4.0))


def test_what_carries_a_load_may_be_heavier_and_nothing_else(known: OnlineKnowledge) -> None:
    """By one per cent of the largest load: a tare, which no moment goes with."""
    names = load("irb360-6-1600").layout.names
    tare = dict(zip(names, known.directions[:, -1].tolist(), strict=True))
    assert tare.pop("EE.m") == pytest.approx(0.04)
    assert not any(tare.values())


def test_directions_and_what_they_leave_are_all_that_a_model_may_be_off_by(
    known: OnlineKnowledge,
) -> None:
    """Variances of torques along a typical motion by the prior's spreads, without friction, are
    those by the directions and, on the mean, what is taken for torque that the model has not."""
    model = load("irb360-6-1600")
    _, q, qd, qdd = along(model.dynamics.kinematics, np.random.default_rng(0), 1000)
    Y = model.dynamics.regressor(q, qd, qdd, np.zeros_like(q))
    spreads = stated_spreads(model.robot)
    spread = np.array([spreads.get(p.name, model.prior_spread) * p.scale
                       for p in model.layout.parameters])  # fmt: skip
    spread[list(known.followed)] = 0.0
    largest = np.abs(Y @ model.p).max(axis=0)
    explained = np.mean(np.sum((Y @ known.directions[:, :-1]) ** 2, axis=2), axis=0)
    left = known.unmodelled**2 - (0.01 * largest) ** 2
    np.testing.assert_allclose(explained + left, np.mean(Y**2 @ spread**2, axis=0), rtol=1e-9)
    np.testing.assert_allclose(known.noise, 0.02 * largest)
    # No three others tell more of it against the noise.
    weighed = (Y * spread / known.noise[:, None]).reshape(-1, len(spread))
    most = np.linalg.eigvalsh(weighed.T @ weighed)[-3:].sum()
    assert len(Y) * np.sum(explained / known.noise**2) == pytest.approx(most)


def test_loads_are_up_to_three_times_as_heavy_as_what_carries_them() -> None:
    """Where nothing else is said; those below a hundredth of the heaviest are not looked for."""
    model = load("linear-delta")
    found = knowledge(model, OnlineSettings())
    assert found.load_scales[0] == pytest.approx(3 * model.body("P")[0])
    assert found.least_mass == pytest.approx(0.03 * model.body("P")[0])


CORNER = 80.0


def residuals(name: str, rate: float, load: np.ndarray) -> np.ndarray:
    """The largest residual with a load, and what is left of it without the load's columns."""
    dynamics = compiled(load_robot(name))
    rest = dict.fromkeys(dynamics.robot.friction_joints, 1e-6)
    m = build_momentum(dynamics.robot, dynamics.kinematics.mechanism, rest)
    body = dynamics.layout.body(dynamics.robot.load_carrier)
    p, loaded = dynamics.p.copy(), dynamics.p.copy()
    p[dynamics.layout.friction] = loaded[dynamics.layout.friction] = 0.0
    loaded[body] += load
    rng, time = np.random.default_rng(3), np.arange(round(0.4 * rate)) / rate
    z, _, qd, qdd = along(dynamics.kinematics, rng, time, period=4.0)
    tau = dynamics.torque(z, qd, qdd, loaded)

    directions = np.column_stack([p, np.eye(p.size)[:, body] @ load])
    kept, torque = ca.SX.sym("k", m.qd.numel(), 2), ca.SX.sym("t", m.qd.numel())
    kept_torque = m.load
    lines = Lowpass.lines(CORNER, 1 / rate)
    momentum, rest = CORNER * (m.H @ directions), m.W @ directions
    x = momentum - rest
    unforced = lines.output(kept, x)
    filtered = lines.output(kept_torque, torque)
    state = ca.veccat(lines.keep(unforced, x), lines.keep(filtered, torque))
    explained = momentum - unforced
    outputs = ca.veccat(filtered - explained[:, 0], explained[:, 1])
    cycle = ca.Function(
        "f", [ca.veccat(kept, kept_torque), ca.vertcat(m.z, m.qd, torque)], [state, outputs]
    )
    begin = ca.Function(
        "f", [m.z, m.qd, torque], [ca.veccat(lines.keep(momentum, x), lines.before * torque)]
    )
    first = begin(z[0], qd[0], tau[0])
    inputs = np.hstack([z, qd, tau])[1:].T
    out = np.array(cycle.mapaccum(inputs.shape[1])(first, inputs)[1])
    residual, taken = np.split(out, 2)
    return np.array([np.abs(residual).max(), np.abs(residual - taken).max()])


@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "linear-delta", "h4"])
def test_a_residual_is_what_the_load_takes(name: str) -> None:
    load = np.array([1.2, 0.06, -0.03, 0.02, 0.01, 0.012, 0.014, 0.001, -0.001, 0.0015])
    coarse, fine = (residuals(name, rate, load) for rate in (1000.0, 2000.0))
    assert coarse[0] > 1.0
    assert coarse[1] < 2e-3 * coarse[0]
    assert fine[1] < 0.3 * coarse[1]  # of second order in the period


ROUNDS = 20


def learnt(online: deltaid.Online) -> np.ndarray:
    """Standard deviation of each drive's speed."""
    return np.sqrt(online.state[online.graph.state.places["speed_variance"]])


@pytest.mark.parametrize("delay", [0.0, 1.4e-3])
def test_noise_of_differences_is_that_of_the_encoder(delay: float) -> None:
    robot = shuttle()
    online = deltaid.Online(robot.model, OnlineSettings(speed="differenced", delay=delay))
    q, tau, held = robot.rounds(np.full(ROUNDS, 0.5))
    online.run(q, None, tau, held)
    share = (1e3 * delay) % 1.0
    of_differences = np.sqrt(np.sum(np.convolve([1 - share, share], [1.0, -1.0]) ** 2))
    true = ENCODER / np.sqrt(12.0) * RATE * of_differences
    np.testing.assert_allclose(learnt(online), true, rtol=0.2)


@pytest.mark.parametrize("noise", [0.003, 0.03])
def test_noise_of_measured_speeds(noise: float) -> None:
    robot, rng = shuttle(), np.random.default_rng(0)
    online = deltaid.Online(robot.model, OnlineSettings())
    q, tau, held = robot.rounds(np.full(ROUNDS, 0.5))
    qd = RATE * np.gradient(np.tile(robot.q, (ROUNDS, 1)), axis=0)
    online.run(q, qd + noise * rng.standard_normal(q.shape), tau, held)
    np.testing.assert_allclose(learnt(online), noise, rtol=0.1)


def test_noise_of_speeds_in_the_momentum_of_a_load_that_is_not_known() -> None:
    """Mean of M D M over masses and first moments of the load, D variances of speeds."""
    model, settings = load("irb360-6-1600"), OnlineSettings(largest_mass=2.0)
    dynamics, known = model.dynamics, knowledge(model, settings)
    momentum = build_momentum(model.robot, dynamics.kinematics.mechanism, {})
    z = np.array(model.home) + np.array([0.1, -0.05, 0.02, 0.4])
    signals = SimpleNamespace(momentum=momentum, z=ca.SX(z))
    cycle: Any = SimpleNamespace(signals=signals, known=known, model=model)
    x, spread, noise = np.array([0.4, 0.1, -0.2, 0.3]), np.array([0.5, 0.2, 0.1, 0.4]), np.ones(4)
    noise *= np.array([1.0, 2.0, 3.0, 4.0]) * 1e-6
    given = (ca.SX(part) for part in (x, spread, noise))
    found = np.array(ca.DM(of_speeds(cycle, *given)))

    def mass_matrix(entries: np.ndarray) -> np.ndarray:
        p, first = model.p.copy(), model.layout.body(known.entries.body).start
        p[[first + k for k in known.entries.shown]] += known.load_scales * entries
        q = dynamics.kinematics.inverse(z)
        return dynamics.terms(q, np.zeros(4), p).M

    M = mass_matrix(x)
    expected = M @ np.diag(noise) @ M
    for unit, variance in zip(np.eye(4), spread, strict=True):
        part = mass_matrix(x + unit) - M
        expected += variance * part @ np.diag(noise) @ part
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_heavy_load_that_hangs_on_is_no_contact() -> None:
    """It is left in motion, 15 ms after the signal, and weighs more than the platform."""
    model, rng, cycles, mass = picked().model, np.random.default_rng(3), 20_000, 4.0
    dynamics = model.dynamics
    z, q, qd, qdd = along(dynamics.kinematics, rng, np.arange(cycles) / RATE, period=7.3)
    signal = np.arange(cycles) // 400 % 2 == 1
    held, moment = np.roll(signal, 15), mass * 1e-4
    heavy = model.with_load(np.array([mass, 0, 0, 0, moment, moment, moment, 0, 0, 0])).p
    tau = np.where(held[:, None], *(dynamics.torque(z, qd, qdd, p) for p in (heavy, model.p)))
    online = shuttle().online(mass)
    tau += online.known.noise * rng.standard_normal(tau.shape)
    contact = online.run(np.round(q / ENCODER) * ENCODER, None, tau, signal.astype(float)).contact
    left = np.flatnonzero(signal[:-1] & ~signal[1:]) + 1
    assert not any(contact[row : row + 10].any() for row in left)
