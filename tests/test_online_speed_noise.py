"""Noise of speeds as the cycle learns it from speeds alone."""

import numpy as np
import pytest

import deltaid
from deltaid.online.settings import OnlineSettings
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
