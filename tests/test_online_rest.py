"""Picks for minutes, with a plant that is as identified: friction at rest shows nothing."""

import numpy as np
import pytest

import deltaid
from shuttling import SPEED_NOISE, shuttle


def picks(
    payload: float, minutes: float, speed_noise: float | None
) -> tuple[np.ndarray, deltaid.OnlineEstimate]:
    """The masses of many picks, and what a stream makes of them."""
    robot, rng = shuttle(), np.random.default_rng(0)
    online = robot.online(payload, speed_noise)
    count = round(60e3 * minutes / len(robot.q))
    masses = payload * np.exp(rng.uniform(np.log(0.05), 0.0, count))
    q, tau, held = robot.rounds(masses)
    noise = online.known.noise * rng.standard_normal(tau.shape)
    return masses, online.run(q, None, tau + noise, held)


def test_minutes_of_picks_have_no_contact_and_right_masses() -> None:
    robot, (masses, found) = shuttle(), picks(1.0, 3.0, SPEED_NOISE)
    assert not found.contact.any()
    soon = np.arange(len(masses)) * len(robot.q) + robot.grips[0] + 200
    error = np.abs(found.mass[soon] - masses)
    assert np.mean(error <= np.maximum(0.1 * masses, 0.06)) >= 0.98
    low, high = found.mass_interval[soon].T
    assert np.mean((low <= masses) & (masses <= high)) >= 0.9


@pytest.mark.parametrize("speed_noise", [SPEED_NOISE, None])
def test_a_load_heavier_than_the_platform_is_no_contact(speed_noise: float | None) -> None:
    """Noise of speeds stands in the load's momentum too, before its mass is known."""
    assert not picks(4.0, 2.0, speed_noise)[1].contact.any()
