"""Who belongs to a type: rows without the robot, slopes of differences, chances of distances."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.reduction import build_reduction
from deltaid.fleets.belonging import AgainstOthers, _belonging, chance, leave_one_out
from deltaid.fleets.coordinates import KINDS, VAGUE, Coordinates, _kind
from deltaid.fleets.mixed_model import Mean, RobotRows, fitted_spreads, mean, slope
from deltaid.robot.load import load_robot


def drawn(seed: int = 3) -> tuple[RobotRows, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of five robots over three numbers; variances between robots, and what was known."""
    rng = np.random.default_rng(seed)
    rows = RobotRows.stacked([rng.standard_normal((n, 3 + 2)) for n in (4, 6, 3, 5, 7)])
    return rows, rng.uniform(0.2, 2.0, 3), np.diag(rng.uniform(0.1, 1.0, 3)), rng.normal(size=3)


def test_a_robot_is_compared_with_what_the_others_say() -> None:
    rows, variance, precision, prior = drawn()
    all_of_them = mean(rows, variance, precision, prior)
    for k in range(len(rows.H)):
        found = leave_one_out(rows, k, all_of_them, (50.0, 20.0), np.zeros(3))
        others = np.arange(len(rows.H)) != k
        P, right = precision.copy(), precision @ prior
        for H, b in zip(rows.H[others], rows.b[others], strict=True):
            V = np.eye(len(H)) + (H * variance) @ H.T
            P += H.T @ np.linalg.solve(V, H)
            right += H.T @ np.linalg.solve(V, b)
        used = np.any(rows.H[k] != 0, axis=1)
        H, b = rows.H[k][used], rows.b[k][used]
        np.testing.assert_allclose(found.e, b - H @ np.linalg.solve(P, right), rtol=1e-8)
        V = np.eye(len(H)) + H @ (np.diag(variance) + np.linalg.inv(P)) @ H.T
        np.testing.assert_allclose(found.V, V, rtol=1e-8, atol=1e-10)
        assert found.rows == used.sum()


def test_one_that_does_not_count_is_compared_with_all_others() -> None:
    rows, variance, precision, prior = drawn()
    counts = np.arange(len(rows.H)) != 2
    without = replace(rows, counts=counts)
    found = leave_one_out(
        without, 2, mean(without, variance, precision, prior), (50.0, 20.0), np.ones(3)
    )
    same = leave_one_out(rows, 2, mean(rows, variance, precision, prior), (50.0, 20.0), np.ones(3))
    np.testing.assert_allclose(found.e, same.e, rtol=1e-8)
    np.testing.assert_allclose(found.V, same.V, rtol=1e-8)


def test_freedom_is_that_of_the_noise_where_robots_are_alike() -> None:
    rows, _, precision, prior = drawn()
    alike = np.full(3, 1e-12)
    sure = mean(rows, alike, 1e9 * precision, prior)
    found = leave_one_out(rows, 0, sure, (50.0, 20.0), np.zeros(3))
    np.testing.assert_allclose(found.freedom, 50.0, rtol=1e-6)
    wide = leave_one_out(rows, 0, sure, (50.0, 20.0), np.full(3, 1e9))
    assert wide.rows == found.rows - 3  # what may be anything takes as many rows
    few = leave_one_out(rows, 2, sure, (50.0, 20.0), np.full(3, 1e9))
    assert few.rows == 0
    np.testing.assert_allclose(few.freedom, 50.0)


def test_the_slope_is_that_of_the_evidence() -> None:
    rows, variance, precision, prior = drawn()
    kinds = np.array([0, 1, 1])

    def mean_at(log: np.ndarray) -> Mean:
        return mean(rows, np.exp(2 * log[kinds]), precision, prior)

    log = 0.5 * np.log([variance[0], variance[1]])
    found = slope(rows, mean_at(log), kinds)
    for k, step in enumerate(1e-5 * np.eye(2)):
        by_differences = (mean_at(log + step).evidence - mean_at(log - step).evidence) / 2e-5
        np.testing.assert_allclose(found[k], by_differences, rtol=1e-5)


@pytest.mark.parametrize("information", [60.0, 12.0, 4.0])
def test_spreads_are_the_most_likely_ones(information: float) -> None:
    """Of rows that show little the prior of spreads decides."""
    coordinates, rng = type_of_robots(), np.random.default_rng(8)
    centre, size = np.log([KINDS[kind] for kind in coordinates.present]), coordinates.size
    truth = centre + rng.uniform(0.5, 1.5, len(centre))
    std = np.exp(truth)[coordinates.kind_of()]
    H = information * rng.standard_normal((12, size + 2, size))
    u = coordinates.prior + std * rng.standard_normal((12, size))
    b = np.einsum("rnu,ru->rn", H, u) + rng.standard_normal(H.shape[:2])
    rows = RobotRows.stacked(
        [np.column_stack([h, np.zeros(len(h)), y]) for h, y in zip(H, b, strict=True)]
    )
    found = fitted_spreads(rows, coordinates)

    def posterior(log: np.ndarray) -> float:
        variance = np.exp(2 * log)[coordinates.kind_of()]
        evidence = mean(rows, variance, coordinates.precision, coordinates.prior).evidence
        return evidence - 0.5 * float(np.sum(((log - centre) / VAGUE) ** 2))

    step = 0.02 * np.eye(len(centre))
    for k, e in enumerate(step):
        up, at, down = (posterior(found.log + x) for x in (e, np.zeros_like(e), -e))
        assert up < at > down
        assert abs(up - down) < 0.1 * (2 * at - up - down)
        others = [np.zeros_like(e), *np.delete(step, k, axis=0)]
        assert all(posterior(found.log + x) <= at + 1e-6 for x in others)
    H = np.array(
        [
            [
                (posterior(found.log + a + c) - posterior(found.log + a - c)
                 - posterior(found.log - a + c) + posterior(found.log - a - c)) / (4 * 0.02**2)
                for a in step
            ]
            for c in step
        ]
    )  # fmt: skip
    np.testing.assert_allclose(found.covariance, np.linalg.inv(-H), rtol=0.05, atol=2e-3)


RNG = np.random.default_rng(4)
ROOT = RNG.standard_normal((6, 9))
V, E = ROOT @ ROOT.T / 9, RNG.standard_normal(6)


def against_others(e: np.ndarray = E, freedom: float = 12.0) -> AgainstOthers:
    return AgainstOthers(e, V, np.eye(6), np.zeros(6), len(e), freedom)


def test_distance_and_its_chance() -> None:
    comparison = against_others()
    assert comparison.distance == pytest.approx(E @ np.linalg.inv(V) @ E)
    for distance, rank in ((comparison.distance, 6), (7.0, 1), (7.0, 2)):
        expected = stats.f.sf(distance / rank, rank, 12.0)
        assert comparison.chance(distance, rank) == pytest.approx(expected, rel=1e-9)


def test_robots_that_belong_are_as_far_as_their_chance_says() -> None:
    """Where V is known but for its level, which so many degrees of freedom tell."""
    rng, freedom, draws = np.random.default_rng(1), 12, 2000
    e = rng.standard_normal((draws, 6)) @ np.linalg.cholesky(V).T
    level = rng.chisquare(freedom, draws) / freedom
    distance = np.einsum("ki,ij,kj->k", e, np.linalg.inv(V), e) / level
    chances = [against_others(freedom=freedom).chance(float(value), 6) for value in distance]
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.025)  # ± 0.007


@pytest.mark.parametrize("twice", [False, True], ids=["independent", "one of them twice"])
def test_what_goes_along_rows_is_least_squares(twice: bool) -> None:
    """A direction that is there twice counts once."""
    F = np.random.default_rng(2).standard_normal((6, 2))
    comparison = against_others().along(np.column_stack([F, F[:, 0]]) if twice else F)
    W = np.linalg.inv(V)
    c = np.linalg.solve(F.T @ W @ F, F.T @ W @ E)
    assert comparison.rank == 2
    assert comparison.gain == pytest.approx(E @ W @ E - (E - F @ c) @ W @ (E - F @ c))
    if not twice:
        np.testing.assert_allclose(comparison.values, c)
        np.testing.assert_allclose(comparison.stds, np.sqrt(np.diag(np.linalg.inv(F.T @ W @ F))))


@pytest.mark.parametrize("share", [1 - 1e-4, 1 + 1e-4])
def test_the_middle_robot_is_at_first_as_far_as_it_should_be(share: float) -> None:
    """The spreads of a core of alike robots are too small: distances fall by a common factor."""
    usual, unit = stats.chi2.ppf(0.5, 6), E / np.sqrt(against_others().distance)
    times = np.array([3.0, 4.0, 5.0, 40.0])
    robots = [against_others(np.sqrt(usual * each) * unit) for each in times]
    chances = np.array([robot.chance(robot.distance, 6) for robot in robots])
    scaled = stats.f.sf(times / 4.5 * usual / 6, 6, 12.0)
    first = _belonging(chances, robots, share * scaled[2], first=True)
    np.testing.assert_array_equal(first, [True, True, share < 1, False])
    later = _belonging(chances, robots, share * chances[1], first=False)
    np.testing.assert_array_equal(later, [True, share < 1, False, False])


def type_of_robots() -> Coordinates:
    robot = load_robot("clavel-delta3")
    reduction = build_reduction(robot, np.arange(len(parameter_layout(robot).names)), (), 0.5)
    kinds = tuple(_kind(variable) for variable in reduction.variables)
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
    """With half of the chance, the other half is that of bodies and all together."""
    type_, rng = type_of_robots(), np.random.default_rng(7)
    H, m = rng.standard_normal((30, type_.size)), rng.standard_normal(type_.size)
    e = 5.0 * (H @ m) / np.linalg.norm(H @ m)
    expected = 2 * 2 * stats.norm.sf(5.0)
    assert chance(robot_of_type(e, H), type_, m) == pytest.approx(expected, rel=1e-4)


def test_freedom_is_that_of_noise_and_spreads_by_their_shares() -> None:
    """Rows with noise of 1 and spreads h s; what may be anything is left aside."""
    h, s = np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 0.2])
    rows = RobotRows.stacked([np.column_stack([np.diag(h), np.zeros(3), np.ones(3)])] * 2)
    found = Mean(s**2, 1e12 * np.eye(3), np.zeros(3), 0.0)
    noise = 1 / (1 + (h * s) ** 2)
    for anything, included in ((np.zeros(3), [0, 1, 2]), (np.array([0.0, 0.0, 1e9]), [0, 1])):
        comparison = leave_one_out(rows, 0, found, (40.0, 5.0), anything)
        inverse = np.mean(noise[included] ** 2) / 40.0 + np.mean((1 - noise[included]) ** 2) / 5.0
        assert comparison.freedom == pytest.approx(1 / inverse)
        assert comparison.rows == len(included)
