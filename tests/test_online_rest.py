"""Picks for minutes, with a plant that is as identified: friction at rest shows nothing."""

import numpy as np
import pytest

import deltaid
from deltaid.online.settings import OnlineSettings
from shuttling import ENCODER, RATE, Shuttle, shuttle

PAYLOAD, MINUTES = 1.0, 3.0
SPEED_NOISE = ENCODER * RATE / np.sqrt(6.0)


@pytest.fixture(scope="module")
def robot() -> Shuttle:
    return shuttle()


def online_of(
    robot: Shuttle, payload: float = PAYLOAD, speed_noise: float | None = SPEED_NOISE
) -> deltaid.Online:
    noise = None if speed_noise is None else (speed_noise,) * 3
    settings = OnlineSettings(speed="differenced", largest_mass=payload, speed_noise=noise)
    return deltaid.Online(robot.model, settings)


def test_minutes_of_picks_have_no_contact_and_right_masses(robot: Shuttle) -> None:
    online, rng = online_of(robot), np.random.default_rng(0)
    masses = PAYLOAD * np.exp(rng.uniform(np.log(0.05), 0.0, round(60e3 * MINUTES / len(robot.q))))
    q, tau, held = robot.rounds(masses)
    found = online.run(q, None, tau + online.known.noise * rng.standard_normal(tau.shape), held)
    assert not found.contact.any()
    soon = np.arange(len(masses)) * len(robot.q) + robot.grips[0] + 200
    error = np.abs(found.mass[soon] - masses)
    assert np.mean(error <= np.maximum(0.1 * masses, 0.06)) >= 0.98
    low, high = found.mass_interval[soon].T
    assert np.mean((low <= masses) & (masses <= high)) >= 0.9


@pytest.mark.parametrize("speed_noise", [SPEED_NOISE, None])
def test_a_load_heavier_than_the_platform_is_no_contact(
    robot: Shuttle, speed_noise: float | None
) -> None:
    """Noise of speeds stands in the load's momentum too, before its mass is known."""
    payload, rng = 4.0, np.random.default_rng(0)
    online = online_of(robot, payload, speed_noise)
    masses = payload * np.exp(rng.uniform(np.log(0.05), 0.0, round(120e3 / len(robot.q))))
    q, tau, held = robot.rounds(masses)
    found = online.run(q, None, tau + online.known.noise * rng.standard_normal(tau.shape), held)
    assert not found.contact.any()
