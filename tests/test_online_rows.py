"""Picks for minutes, with rows that a bus delivers late, twice or damaged."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import deltaid
from shuttling import ENCODER, RATE, SPEED_NOISE, shuttle

ROUNDS, MASS = 40, 0.5


@pytest.fixture(scope="module")
def used() -> deltaid.Online:
    return shuttle().online()


@pytest.fixture
def online(used: deltaid.Online) -> deltaid.Online:
    used.reset()
    return used


@pytest.fixture
def rows(online: deltaid.Online) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, tau, held = shuttle().rounds(np.full(ROUNDS, MASS))
    rng = np.random.default_rng(2)
    return q, tau + online.known.noise * rng.standard_normal(tau.shape), held


def assert_masses(found: deltaid.OnlineEstimate) -> None:
    """0.2 s after each grip."""
    soon = np.arange(ROUNDS) * len(shuttle().q) + shuttle().grips[0] + 200
    np.testing.assert_allclose(found.mass[soon], MASS, atol=0.06)


@pytest.mark.parametrize("stamped", [True, False])
def test_stale_rows_are_flagged_and_skipped(
    online: deltaid.Online, rows: tuple[np.ndarray, ...], *, stamped: bool
) -> None:
    q, tau, held = rows
    stale = np.flatnonzero(np.random.default_rng(3).uniform(size=len(q)) < 0.02)
    stale = stale[stale > 10]
    stamps = np.arange(len(q)) / RATE
    for k in stale:
        q[k], tau[k], stamps[k] = q[k - 1], tau[k - 1], stamps[k - 1]
    elapsed = np.diff(stamps, prepend=-1 / RATE) if stamped else None
    found = online.run(q, None, tau, held, elapsed)
    assert np.flatnonzero(~found.good).tolist() == stale.tolist()
    assert not found.contact.any()
    assert_masses(found)


def test_stamps_take_the_jitter_out_of_rows(
    online: deltaid.Online, rows: tuple[np.ndarray, ...]
) -> None:
    """0.1 ms, as a standard deviation: differences of positions have a tenth of the speed."""
    _, tau, held = rows
    k = np.arange(len(tau))
    late = np.clip(1e-4 * np.random.default_rng(4).standard_normal(len(k)), -3e-4, 3e-4)
    n, turn = len(shuttle().q), np.vstack([shuttle().q, shuttle().q[:1]])
    course = CubicSpline(np.arange(n + 1), turn, bc_type="periodic")
    q = np.round(course((k + RATE * late) % n) / ENCODER) * ENCODER
    stamps = k / RATE + late
    found = online.run(q, None, tau, held, np.diff(stamps, prepend=-1 / RATE))
    assert not found.contact.any()
    assert found.good.all()
    assert_masses(found)


def test_a_jump_and_a_torque_that_cannot_be_are_skipped(
    online: deltaid.Online, rows: tuple[np.ndarray, ...]
) -> None:
    q, tau, held = rows
    q[5000, 1] += 0.5
    tau[9000, 0] = 1e6
    found = online.run(q, None, tau, held)
    assert np.flatnonzero(~found.good).tolist() == [5000, 9000]
    assert not found.contact.any()
    assert_masses(found)


def test_a_position_that_stays_where_it_jumped_is_believed_again(
    online: deltaid.Online, rows: tuple[np.ndarray, ...]
) -> None:
    q, tau, held = rows
    q[5000:] += 0.05
    good = online.run(q[:6000], None, tau[:6000], held[:6000]).good
    assert not good[5000:5020].any()
    assert good[5030:].all()


def test_nothing_is_learnt_while_a_bus_stands_still(
    online: deltaid.Online, rows: tuple[np.ndarray, ...]
) -> None:
    """For 60 ms within a move, behind which torques are others."""
    q, tau, held = (part[:6000] for part in rows)
    first = 4200
    q[first : first + 60], tau[first : first + 60] = q[first], tau[first]
    elapsed = np.full(len(q), 1 / RATE)
    elapsed[first + 1 : first + 60], elapsed[first + 60] = 0.0, 60 / RATE
    found = online.run(q, None, tau, held, elapsed)
    assert np.flatnonzero(~found.good).tolist() == list(range(first + 1, first + 60))
    assert not found.contact.any()


def test_a_hole_in_stamps_begins_anew(online: deltaid.Online, rows: tuple[np.ndarray, ...]) -> None:
    """Three rows that were lost within a move, without a cycle for them."""
    q, tau, held = (np.delete(part[:9000], slice(4200, 4203), axis=0) for part in rows)
    elapsed = np.full(len(q), 1 / RATE)
    elapsed[4200] = 4 / RATE
    found = online.run(q, None, tau, held, elapsed)
    assert not found.contact.any()
    assert found.mass[8 * len(shuttle().q)] == 0


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
