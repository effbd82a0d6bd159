"""Rows of random robots: who is looked at is left out; slopes are those of differences."""

import numpy as np
import pytest

from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.reduction import build_reduction
from deltaid.fleets.belonging import left_out
from deltaid.fleets.coordinates import KINDS, VAGUE, Coordinates, _kind
from deltaid.fleets.mixed_model import Mean, RobotRows, mean, slope
from deltaid.fleets.spreads import fitted_spreads
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
        found = left_out(rows, k, all_of_them, (50.0, 20.0), np.zeros(3))
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
    without = rows.counting(counts)
    found = left_out(
        without, 2, mean(without, variance, precision, prior), (50.0, 20.0), np.ones(3)
    )
    same = left_out(rows, 2, mean(rows, variance, precision, prior), (50.0, 20.0), np.ones(3))
    np.testing.assert_allclose(found.e, same.e, rtol=1e-8)
    np.testing.assert_allclose(found.V, same.V, rtol=1e-8)


def test_freedom_is_that_of_the_noise_where_robots_are_alike() -> None:
    rows, _, precision, prior = drawn()
    alike = np.full(3, 1e-12)
    sure = mean(rows, alike, 1e9 * precision, prior)
    found = left_out(rows, 0, sure, (50.0, 20.0), np.zeros(3))
    np.testing.assert_allclose(found.freedom, 50.0, rtol=1e-6)
    wide = left_out(rows, 0, sure, (50.0, 20.0), np.full(3, 1e9))
    assert wide.rows == found.rows - 3  # what may be anything takes as many rows
    few = left_out(rows, 2, sure, (50.0, 20.0), np.full(3, 1e9))
    assert few.rows == 0
    np.testing.assert_allclose(few.freedom, 50.0)


def test_the_slope_is_that_of_the_evidence() -> None:
    rows, variance, precision, prior = drawn()
    kinds = np.array([0, 1, 1])

    def at(log: np.ndarray) -> Mean:
        return mean(rows, np.exp(2 * log[kinds]), precision, prior)

    log = 0.5 * np.log([variance[0], variance[1]])
    found = slope(rows, at(log), kinds)
    for k, step in enumerate(1e-5 * np.eye(2)):
        by_differences = (at(log + step).evidence - at(log - step).evidence) / 2e-5
        np.testing.assert_allclose(found[k], by_differences, rtol=1e-5)


@pytest.mark.parametrize("told", [60.0, 12.0, 4.0])
def test_spreads_are_the_most_likely_ones(told: float) -> None:
    """Of rows that show little the prior of spreads decides."""
    robot, rng = load_robot("clavel-delta3"), np.random.default_rng(8)
    reduction = build_reduction(robot, np.arange(len(parameter_layout(robot).names)), (), 0.5)
    kinds = tuple(_kind(one) for one in reduction.variables)
    coordinates = Coordinates(robot, reduction, kinds, (), reduction.scale, 0.5)
    centre, size = np.log([KINDS[kind] for kind in coordinates.present]), len(kinds)
    truth = centre + rng.uniform(0.5, 1.5, len(centre))
    std = np.exp(truth)[coordinates.kind_of()]
    H = told * rng.standard_normal((12, size + 2, size))
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
