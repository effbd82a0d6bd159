"""How often a robot that belongs to a type is as far from the others: F of squared distances."""

import numpy as np
import pytest
from scipy import stats

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.reduction import build_reduction
from deltaid.fleets.belonging import AgainstOthers, _belonging, chance
from deltaid.fleets.belonging import left_out as left_out_of
from deltaid.fleets.coordinates import Coordinates, _kind
from deltaid.fleets.mixed_model import Mean, RobotRows
from deltaid.robot.load import load_robot

RNG = np.random.default_rng(4)
ROOT = RNG.standard_normal((6, 9))
V, E = ROOT @ ROOT.T / 9, RNG.standard_normal(6)


def left_out(e: np.ndarray = E, freedom: float = 12.0) -> AgainstOthers:
    return AgainstOthers(e, V, np.eye(6), np.zeros(6), len(e), freedom)


def test_distance_and_its_chance() -> None:
    one = left_out()
    assert one.distance == pytest.approx(E @ np.linalg.inv(V) @ E)
    for distance, rank in ((one.distance, 6), (7.0, 1), (7.0, 2)):
        expected = stats.f.sf(distance / rank, rank, 12.0)
        assert one.chance(distance, rank) == pytest.approx(expected, rel=1e-9)


def test_robots_that_belong_are_as_far_as_their_chance_says() -> None:
    """Where V is known but for its level, which so many degrees of freedom tell."""
    rng, freedom, draws = np.random.default_rng(1), 12, 2000
    e = rng.standard_normal((draws, 6)) @ np.linalg.cholesky(V).T
    level = rng.chisquare(freedom, draws) / freedom
    distance = np.einsum("ki,ij,kj->k", e, np.linalg.inv(V), e) / level
    chances = [left_out(freedom=freedom).chance(float(one), 6) for one in distance]
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.025)  # ± 0.007


@pytest.mark.parametrize("twice", [False, True], ids=["independent", "one of them twice"])
def test_what_goes_along_rows_is_least_squares(twice: bool) -> None:
    """A direction that is there twice counts once."""
    F = np.random.default_rng(2).standard_normal((6, 2))
    one = left_out().along(np.column_stack([F, F[:, 0]]) if twice else F)
    W = np.linalg.inv(V)
    c = np.linalg.solve(F.T @ W @ F, F.T @ W @ E)
    assert one.rank == 2
    assert one.gain == pytest.approx(E @ W @ E - (E - F @ c) @ W @ (E - F @ c))
    if not twice:
        np.testing.assert_allclose(one.values, c)
        np.testing.assert_allclose(one.stds, np.sqrt(np.diag(np.linalg.inv(F.T @ W @ F))))


@pytest.mark.parametrize("share", [1 - 1e-4, 1 + 1e-4])
def test_the_middle_robot_is_at_first_as_far_as_it_should_be(share: float) -> None:
    """The spreads of a core of alike robots are too small: distances fall by a common factor."""
    usual, unit = stats.chi2.ppf(0.5, 6), E / np.sqrt(left_out().distance)
    times = np.array([3.0, 4.0, 5.0, 40.0])
    robots = [left_out(np.sqrt(usual * each) * unit) for each in times]
    chances = np.array([one.chance(one.distance, 6) for one in robots])
    scaled = stats.f.sf(times / 4.5 * usual / 6, 6, 12.0)
    first = _belonging(chances, robots, share * scaled[2], first=True)
    np.testing.assert_array_equal(first, [True, True, share < 1, False])
    later = _belonging(chances, robots, share * chances[1], first=False)
    np.testing.assert_array_equal(later, [True, share < 1, False, False])


def type_of_robots() -> Coordinates:
    robot = load_robot("clavel-delta3")
    reduction = build_reduction(robot, np.arange(len(parameter_layout(robot).names)), (), 0.5)
    kinds = tuple(_kind(one) for one in reduction.variables)
    return Coordinates(robot, reduction, kinds, (), reduction.scale, 0.5)


def robot_of_type(e: np.ndarray, H: np.ndarray) -> AgainstOthers:
    """With white noise of a known level."""
    return AgainstOthers(e, np.eye(len(e)), H, np.zeros(len(e)), len(e), 1e9)


def test_a_robot_that_belongs_is_seldom_far_in_any_direction() -> None:
    """However many directions are looked along, and not much more seldom than is said."""
    type_, rng = type_of_robots(), np.random.default_rng(6)
    H, m = rng.standard_normal((30, type_.size)), rng.standard_normal(type_.size)
    draws = rng.standard_normal((300, 30))
    chances = np.array([chance(robot_of_type(e, H), type_, m) for e in draws])
    assert 0.2 < np.mean(chances < 0.3) < 0.35  # 300 draws tell it to 0.03


def test_torques_that_are_all_too_large_are_one_direction() -> None:
    """Of as many as there are bodies, this one and all together; friction is none."""
    type_, rng = type_of_robots(), np.random.default_rng(7)
    H, m = rng.standard_normal((30, type_.size)), rng.standard_normal(type_.size)
    e = 5.0 * (H @ m) / np.linalg.norm(H @ m)
    bodies = {one.owner for one in type_.reduction.variables if one.kind == "inertia"}
    expected = (len(bodies) + 2) * 2 * stats.norm.sf(5.0)
    assert chance(robot_of_type(e, H), type_, m) == pytest.approx(expected, rel=1e-4)


def test_freedom_is_that_of_noise_and_spreads_by_their_shares() -> None:
    """Rows with noise of 1 and spreads h s; what may be anything is left aside."""
    h, s = np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 0.2])
    rows = RobotRows.stacked([np.column_stack([np.diag(h), np.zeros(3), np.ones(3)])] * 2)
    found = Mean(s**2, 1e12 * np.eye(3), np.zeros(3), 0.0)
    noise = 1 / (1 + (h * s) ** 2)
    for anything, kept in ((np.zeros(3), [0, 1, 2]), (np.array([0.0, 0.0, 1e9]), [0, 1])):
        one = left_out_of(rows, 0, found, (40.0, 5.0), anything)
        inverse = np.mean(noise[kept] ** 2) / 40.0 + np.mean((1 - noise[kept]) ** 2) / 5.0
        assert one.freedom == pytest.approx(1 / inverse)
        assert one.rows == len(kept)
