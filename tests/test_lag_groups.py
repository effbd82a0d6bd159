"""When lags contradict a hypothesis: Hotelling's T² of what it leaves, at its exact limits.

Covariances come from the scatter between 40 stretches, so T² with k directions is
39 k / (40 − k) times an F with k and 40 − k degrees of freedom.
"""

import numpy as np
import pytest
from scipy import stats

from deltaid.effects import lag_groups
from deltaid.effects.lag_groups import agree, chosen_groups, common_lag

STRETCHES, SIGMA = 40, 1e-3
APART = np.array([1.0, -1.0, 0.0, 0.0]) / np.sqrt(2)  # of length 1, and none of a common lag
NEAR = 1e-4  # by which a T² is off its limit, as a share


def limit(directions: int, rejected: float) -> float:
    """What T² exceeds in such a share of cases."""
    rest = STRETCHES - directions
    f = stats.f.isf(rejected, directions, rest)
    return float((STRETCHES - 1) * directions / rest * f)


def correlated(n: int, seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).standard_normal((n, 3 * n))
    return SIGMA**2 * root @ root.T / (3 * n)


def groups(lags: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """Of drives whose lags are known alike well."""
    groups = chosen_groups(lags, SIGMA**2 * np.eye(len(lags)))
    return tuple(group.drives for group in groups)


@pytest.mark.parametrize("directions", [1, 2, 5])
def test_a_true_hypothesis_is_rejected_as_often_as_it_says(directions: int) -> None:
    """Of the mean of 40 stretches and its covariance by their scatter."""
    rng, draws = np.random.default_rng(directions), 3000
    x = rng.standard_normal((draws, STRETCHES, directions))
    mean = x.mean(axis=1)
    left = x - mean[:, None]
    covariance = np.swapaxes(left, 1, 2) @ left / (STRETCHES - 1) / STRETCHES
    T2 = np.einsum("ki,kij,kj->k", mean, np.linalg.inv(covariance), mean)
    rejected = np.mean(lag_groups.limit(directions, 0.1) < T2)
    assert rejected == pytest.approx(0.1, abs=0.02)  # 3000 draws tell it to 0.005
    assert lag_groups.limit(directions, 0.1) == pytest.approx(limit(directions, 0.1), rel=1e-9)


def test_sizes_agree_up_to_one_in_a_hundred() -> None:
    """As many directions as there are sizes but one: what is common to them contradicts nothing."""
    for n in (2, 3, 4):
        covariance = correlated(n)
        apart = np.linalg.cholesky(covariance) @ np.arange(1.0, n + 1)
        ones = np.linalg.solve(covariance, np.ones(n))
        apart -= ones @ apart / ones.sum()  # what least squares leaves of a common size
        apart /= np.sqrt(apart @ np.linalg.solve(covariance, apart))
        for share, expected in ((1 - NEAR, True), (1 + NEAR, False)):
            assert agree(5.0 + np.sqrt(share * limit(n - 1, 0.01)) * apart, covariance) == expected


@pytest.mark.parametrize(
    ("direction", "least", "beyond"),
    [
        # One lag for all leaves less than none by T² of a single direction; else all directions.
        (np.full(4, 0.5), limit(1, 0.5e-3), ((0, 1, 2, 3),)),
        (APART, limit(4, 0.5e-3), None),
    ],
    ids=["alike", "apart"],
)
def test_no_lag_is_rejected_once_in_a_thousand(
    direction: np.ndarray, least: float, beyond: tuple[tuple[int, ...], ...] | None
) -> None:
    """Half of it for each of the two ways to look."""
    for share in (1 - NEAR, 1 + NEAR):
        found = groups(SIGMA * np.sqrt(share * least) * direction)
        assert (found == ()) == (share < 1)
        assert share < 1 or beyond is None or found == beyond


def test_one_lag_for_all_is_rejected_once_in_a_thousand() -> None:
    for share, alike in ((1 - NEAR, True), (1 + NEAR, False)):
        lags = 1.0 + SIGMA * np.sqrt(share * limit(3, 1e-3)) * APART
        assert (groups(lags) == ((0, 1, 2, 3),)) == alike


def test_drives_that_differ_by_chance_four_times_in_five_have_one_lag() -> None:
    """Two groups leave two of four directions."""
    for share, alike in ((1 - NEAR, True), (1 + NEAR, False)):
        # The first two differ; the third lies between them, the fourth far away.
        lags = np.array([1.0, 1.0, 1.0, 2.0]) + SIGMA * np.sqrt(share * limit(2, 0.2)) * APART
        assert (groups(lags) == ((0, 1, 2), (3,))) == alike


def test_where_three_lags_differ_a_fourth_that_agrees_does_so_by_chance() -> None:
    assert groups(np.array([1.0, 2.0, 3.0, 3.0])) == ((0,), (1,), (2,), (3,))
    assert groups(np.array([2.0, 2.0, 3.0, 3.0])) == ((0, 1), (2, 3))
    assert groups(np.array([1.0, 2.0, 0.0, 0.0])) == ((0,), (1,))


def test_a_drive_that_hardly_moves_has_the_lag_of_the_others() -> None:
    """Though none at all would be nearer to its own estimate."""
    covariance = np.diag([SIGMA, SIGMA, SIGMA, 1e3 * SIGMA]) ** 2
    (group,) = chosen_groups(np.array([1.0, 1.0, 1.0, 0.2]), covariance)
    assert group.drives == (0, 1, 2, 3)


def test_a_common_lag_is_as_certain_as_the_weighted_mean() -> None:
    covariance = correlated(4, seed=2)
    weight = np.sum(np.linalg.inv(covariance))
    assert common_lag(np.zeros(4), covariance)[1] == pytest.approx(weight**-0.5)


def test_lags_of_a_group_are_their_weighted_mean() -> None:
    covariance = correlated(3, seed=3)
    lags = 1.0 + 0.3 * np.sqrt(np.diag(covariance)) * [1.0, -1.0, 0.5]
    (group,) = chosen_groups(lags, covariance)
    weights = np.linalg.solve(covariance, np.ones(3))
    np.testing.assert_allclose(group.delay, weights @ lags / weights.sum())
    assert group.drives == (0, 1, 2)
