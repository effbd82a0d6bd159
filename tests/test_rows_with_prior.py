"""Least squares of rows with a prior: values, and how certain they are."""

import numpy as np
import pytest

from deltaid.identification.rows_with_prior import BLOCKS, Prior, Sheet, solved, stretches


@pytest.mark.parametrize("samples", [1, BLOCKS - 1, BLOCKS, 97])
def test_stretches_of_a_short_recording_lie_in_it(samples: int) -> None:
    starts = stretches(samples)
    assert starts[0] == 0
    assert np.all(np.diff(starts) > 0)
    assert starts[-1] < samples
    assert len(starts) == min(samples, BLOCKS)


def sheet(rng: np.random.Generator, samples: int, noise: float) -> Sheet:
    """Rows of two drives of x = (2, −1) and a = 3, the second with ten times the noise."""
    X, A = rng.standard_normal((2, samples, 2)), rng.standard_normal((2, samples, 1))
    level = noise * np.array([[1.0], [10.0]])
    tau = X @ [2.0, -1.0] + A @ [3.0] + level * rng.standard_normal((2, samples))
    return Sheet(X, A, tau)


def test_what_is_beside_errs_as_its_covariance_says() -> None:
    rng, nothing = np.random.default_rng(3), (np.zeros(1), np.array([np.inf]))
    prior = Prior(np.eye(2), np.array([2.0, -1.0])).beside(*nothing)
    found = [solved([sheet(rng, size, 0.1) for size in (39, 300)], prior) for _ in range(200)]
    errors = np.array([one.a[0] - 3.0 for one in found])
    deviations = np.array([one.covariance[0, 0] ** 0.5 for one in found])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.1 / np.sqrt(339), rel=0.2)
    assert np.mean(deviations) == pytest.approx(np.std(errors), rel=0.2)


def test_what_is_known_before_counts_by_its_deviation() -> None:
    one = Sheet(np.zeros((1, 4, 1)), np.zeros((1, 4, 1)), np.ones((1, 4)))
    prior = Prior(np.array([[2.0]]), np.array([14.0])).beside(np.array([0.5]), np.array([0.1]))
    found = solved([one], prior)
    np.testing.assert_allclose(found.x, 7.0)
    np.testing.assert_allclose(found.a, 0.5)
    np.testing.assert_allclose(found.covariance, 0.01)


def test_instruments_are_not_biased_by_noise_that_columns_share_with_torques() -> None:
    rng, nothing = np.random.default_rng(4), (np.zeros(1), np.array([np.inf]))
    prior = Prior(np.array([[1e-6]]), np.zeros(1)).beside(*nothing)
    clean, noise = rng.standard_normal((1, 4000, 2)), rng.standard_normal((1, 4000))
    rows = clean + 0.5 * noise[:, :, None]
    tau = clean @ [2.0, 3.0] + noise
    one = Sheet(rows[:, :, :1], rows[:, :, 1:], tau)
    by = [Sheet(clean[:, :, :1], clean[:, :, 1:], tau)]
    biased, right = solved([one], prior), solved([one], prior, [by])
    assert abs(right.a[0] - 3.0) < 3 * right.covariance[0, 0] ** 0.5
    assert abs(biased.a[0] - 3.0) > 5 * biased.covariance[0, 0] ** 0.5
    np.testing.assert_allclose(right.x, 2.0, atol=0.2)
