"""Noise of speeds as the cycle learns it from speeds alone."""

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import deltaid
from deltaid.model.model import load
from deltaid.motion.random_motion import random_motion
from deltaid.online.cycle import of_speeds
from deltaid.online.momentum import build_momentum
from deltaid.online.settings import OnlineSettings, knowledge
from picking import picked
from shuttling import ENCODER, RATE, shuttle

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
    motion = random_motion(dynamics.kinematics, rng, period=7.3)
    z, zd, zdd = motion.evaluate(np.arange(cycles) / RATE)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    told = np.arange(cycles) // 400 % 2 == 1
    held, moment = np.roll(told, 15), mass * 1e-4
    heavy = model.with_load(np.array([mass, 0, 0, 0, moment, moment, moment, 0, 0, 0])).p
    tau = np.where(held[:, None], *(dynamics.torque(z, qd, qdd, p) for p in (heavy, model.p)))
    online = shuttle().online(mass)
    tau += online.known.noise * rng.standard_normal(tau.shape)
    contact = online.run(np.round(q / ENCODER) * ENCODER, None, tau, told.astype(float)).contact
    left = np.flatnonzero(told[:-1] & ~told[1:]) + 1
    assert not any(contact[row : row + 10].any() for row in left)
