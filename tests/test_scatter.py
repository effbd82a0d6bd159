"""Variances by the scatter between groups of samples, and whether intervals hold the truth by them.

Over 200 seeds of noise: `python benchmarks/coverage_of_intervals.py`.
"""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binom

from deltaid.estimation.information import Information, merge
from deltaid.estimation.scatter import NORMAL, Noise, Scatter, half_width, inverse, observe
from deltaid.identification.gathering import Gathered
from interval_coverage import ROBOTS, covered, covered_by_white_formula, estimates, wandering

SAMPLES, SIGMA = 60, 0.4
TIME = np.split(np.arange(SAMPLES), 6)
PLACE = [np.arange(first, SAMPLES, 6) for first in range(6)]


def dense(
    Q: np.ndarray, left: np.ndarray, groups: list[np.ndarray], u: np.ndarray
) -> tuple[float, float]:
    """v and ν of uᵀs by the residuals' covariance (1 − QQᵀ) σ² of all samples.

    (Σ_g (uᵀs_g)² is a quadratic form of residuals; its mean and variance for white noise tell the
    scale and the degrees of freedom.)
    """
    w, C = Q @ u, np.eye(len(Q)) - Q @ Q.T
    parts = np.array([w * np.isin(np.arange(SAMPLES), g) for g in groups])
    omega = parts @ C @ parts.T
    mean, variance = np.trace(omega), 2 * np.sum(omega**2)
    return float(w @ w * np.sum((parts @ left) ** 2) / mean), float(2 * mean**2 / variance)


def of_groups(X: np.ndarray, tau: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    both = np.column_stack([X, tau])
    return np.stack([both[g].T @ both[g] for g in groups])


def fitted(rng: np.random.Generator, tau_noise: np.ndarray) -> tuple[np.ndarray, ...]:
    """X, τ, R and the values of least squares."""
    X = np.column_stack([rng.standard_normal(SAMPLES), rng.uniform(0.0, 2.0, SAMPLES)])
    tau = X @ [2.0, -1.0] + tau_noise
    return X, tau, np.linalg.qr(X, mode="r"), np.linalg.lstsq(X, tau, rcond=None)[0]


@pytest.mark.parametrize("facts", [0, 2])
def test_variances_are_those_of_dense_residuals(facts: int) -> None:
    """What facts tell beside samples errs by the white noise σ̂, whose freedom is endless."""
    rng = np.random.default_rng(facts)
    X, F = rng.standard_normal((SAMPLES, 3)), 4.0 * np.eye(3)[:facts]
    R = np.linalg.qr(np.vstack([X, F]), mode="r")
    Q = X @ np.linalg.inv(R)
    left = rng.standard_normal(SAMPLES)
    shares = np.stack([Q[g].T @ Q[g] for g in TIME])
    scores = np.stack([Q[g].T @ left[g] for g in TIME])
    U = rng.standard_normal((3, 4))
    v, nu = Scatter(shares, scores, SIGMA).variances(U)
    for k, u in enumerate(U.T):
        by_groups, freedom = dense(Q, left, TIME, u)
        w = Q @ u
        by_facts = SIGMA**2 * (u @ u - w @ w)
        assert v[k] == pytest.approx(by_groups + by_facts)
        assert nu[k] == pytest.approx(freedom * (1 + by_facts / by_groups) ** 2)


def test_what_facts_alone_tell_errs_by_the_known_noise() -> None:
    shares, scores = np.zeros((4, 2, 2)), np.array([[0.0, 1.0], [0.0, -1.0]] * 2)
    shares[:, 1, 1] = 0.25
    v, nu = Scatter(shares, scores, SIGMA).variances(np.array([[3.0], [0.0]]))
    assert v[0] == pytest.approx(9 * SIGMA**2)
    assert stats.t.ppf(0.975, nu[0]) == pytest.approx(stats.norm.ppf(0.975), rel=1e-6)


def test_the_grouping_that_scatters_most_is_believed() -> None:
    rng = np.random.default_rng(3)
    X, tau, R, values = fitted(rng, np.tile(rng.standard_normal(6), 10))
    groupings = [("time", of_groups(X, tau, TIME)), ("place", of_groups(X, tau, PLACE))]
    for order in (groupings, groupings[::-1]):
        noise = observe(R, values, SIGMA, 58.0, order)
        assert noise.groups == "place"
        U = inverse(R).T
        Q = X @ inverse(R)
        expected = [dense(Q, tau - X @ values, PLACE, u) for u in U.T]
        std, freedom = noise.deviations(U)
        np.testing.assert_allclose(std, np.sqrt([v for v, _ in expected]), rtol=1e-9)
        np.testing.assert_allclose(freedom, [nu for _, nu in expected], rtol=1e-9)


def test_without_groups_noise_is_white() -> None:
    """And so it is where all of a combination comes from one group, with the widest Student's t."""
    rng = np.random.default_rng(4)
    X, tau, R, values = fitted(rng, rng.standard_normal(SAMPLES))
    white = SIGMA * np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    group_products = of_groups(X, tau, [np.arange(SAMPLES)])
    for groupings, freedom in (([], 58.0), ([("time", group_products)], 58.0)):
        std, nu = observe(R, values, SIGMA, 58.0, groupings).deviations(inverse(R).T)
        np.testing.assert_allclose(std, white)
        np.testing.assert_allclose(nu, freedom)
    alone = Scatter(np.eye(2)[None], np.ones((1, 2)))
    std, nu = Noise(R, SIGMA, 58.0, alone, "time").deviations(np.array([[3.0], [4.0]]))
    np.testing.assert_allclose(std, 5 * SIGMA)
    np.testing.assert_allclose(nu, 1.0)


def test_groups_are_weighed_drive_by_drive() -> None:
    """Σ_i w_i [Y_i, τ_i]ᵀ[Y_i, τ_i] of each group, from factors of blocks and sums of places."""
    rng, weights = np.random.default_rng(5), np.array([4.0, 0.25])
    rows = rng.standard_normal((3, 2, 8, 3))  # groups, drives, samples, columns
    blocks = tuple(
        Information(np.arange(2), np.linalg.qr(row, mode="r"), np.full(2, 8.0), np.ones(2))
        for row in rows
    )
    places = np.swapaxes(rows, 2, 3) @ rows
    found = Gathered((blocks,), places, merge(blocks)).weighted(weights)
    expected = [sum(w * x.T @ x for w, x in zip(weights, row, strict=True)) for row in rows]
    np.testing.assert_allclose(found["time"], expected)
    np.testing.assert_allclose(found["place"], expected)


def test_intervals_take_students_t_of_the_part_that_is_estimated() -> None:
    std, by_noise, freedom = np.full(3, 2.0), np.array([2.0, 1.0, 0.0]), np.full(3, 4.0)
    expected = 2.0 * stats.t.ppf(0.975, [4.0, 4.0 * 2.0**4, np.inf])
    np.testing.assert_allclose(half_width(std, by_noise, freedom), expected)
    assert pytest.approx(expected[2]) == 2.0 * NORMAL


SEEDS = 100


@pytest.mark.parametrize("name", ROBOTS)
def test_intervals_cover_as_often_as_they_say(name: str) -> None:
    share = covered(*estimates(name, "white", SEEDS, wandering))
    # One parameter in all seeds: a chance of 1e-4 lies beyond this bound at 93 %.
    low = binom.ppf(1e-4, SEEDS, 0.93) / SEEDS
    assert 0.92 <= share.mean() <= 0.975
    assert np.all(share >= low), share


@pytest.mark.parametrize(("kind", "oftener"), [("coloured", 2.4), ("ripple", 4.0)])
def test_noise_that_is_not_white_is_noticed(kind: str, oftener: float) -> None:
    """The formula for white noise misses the truth so many times as often; without the scatter
    between spans of time it would be twice as often of coloured noise."""
    truth, found = estimates(ROBOTS[0], kind, SEEDS, wandering)
    share, white = covered(truth, found), covered_by_white_formula(truth, found)
    assert 0.92 <= share.mean() <= 0.975
    assert np.all(share >= 0.8), share
    assert 1 - white.mean() > oftener * (1 - share.mean())
