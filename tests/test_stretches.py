"""How certain something is by the scatter between stretches of time, against formulas written out.

Noise here is the same in all samples of a stretch, and in all drives, as that of a wrong model is:
taken for white it would be far too small.
"""

import numpy as np
import pytest
from scipy import stats

from deltaid.check.wiring.homing import BLOCKS as OF_ZEROS
from deltaid.check.wiring.homing import Shifts
from deltaid.identification.explained import account
from deltaid.identification.friction_rows import FrictionRows
from deltaid.identification.lag import Basis, Lag, deviations
from deltaid.identification.patterns import Pattern
from deltaid.identification.rows_with_prior import BLOCKS, Prior, Sheet, solved
from deltaid.identification.velocity_stage import _lag

LONG = 4  # samples a stretch
SAMPLES = BLOCKS * LONG
NOTHING_KNOWN = Prior(np.zeros((0, 4)), np.zeros(0))


def stretched(rng: np.random.Generator, *columns: int) -> np.ndarray:
    """Numbers that stay as they are within a stretch."""
    return np.repeat(rng.standard_normal((BLOCKS, *columns)), LONG, axis=0)


def in_turn() -> np.ndarray:
    """Noise of which nothing is left in the sum over a stretch."""
    return np.tile([1.0, -1.0], SAMPLES // 2)


def of_stretches(rows: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Sums over each stretch of all drives, of rows times what is left: (stretches, columns)."""
    return (rows * left[:, None]).reshape(-1, BLOCKS, LONG, rows.shape[1]).sum(axis=(0, 2))


def sheet(rng: np.random.Generator) -> Sheet:
    """Rows of two drives of x = (2, −1) and a = (3, 0.5), which goes on for a stretch."""
    X, A = rng.standard_normal((2, SAMPLES, 2)), np.stack([stretched(rng, 2) for _ in range(2)])
    return Sheet(X, A, X @ [2.0, -1.0] + A @ [3.0, 0.5] + stretched(rng))


def clustered(sheets: list[Sheet]) -> tuple[np.ndarray, np.ndarray]:
    """a by least squares, and its covariance (Liang and Zeger's, n/(n − 1) for n stretches)."""
    whole = np.vstack([one.over(one.noise) for one in sheets])
    tau = np.concatenate([(one.tau / one.noise[:, None]).ravel() for one in sheets])
    X, A = whole[:, :2], whole[:, 2:]
    found = np.linalg.lstsq(whole, tau, rcond=None)[0]
    A = A - X @ np.linalg.lstsq(X, A, rcond=None)[0]
    parts = [
        of_stretches(*both) for both in zip(np.split(A, len(sheets)),
                                            np.split(tau - whole @ found, len(sheets)), strict=True)
    ]  # fmt: skip
    middle = sum(s.T @ s for s in parts) * BLOCKS / (BLOCKS - 1)
    bread = np.linalg.inv(A.T @ A)
    return found[2:], bread @ middle @ bread


@pytest.mark.parametrize("recordings", [1, 2])
def test_rows_beside_a_prior_have_the_covariance_of_clusters(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    sheets = [sheet(rng) for _ in range(recordings)]
    a, covariance = clustered(sheets)
    found = solved(sheets, NOTHING_KNOWN)
    np.testing.assert_allclose(found.a, a, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-8)


def test_rows_beside_a_prior_err_as_their_scatter_says() -> None:
    rng = np.random.default_rng(5)
    found = [solved([sheet(rng)], NOTHING_KNOWN) for _ in range(150)]
    errors = np.array([one.a for one in found]) - [3.0, 0.5]
    said = np.mean([np.diag(one.covariance) for one in found], axis=0)
    np.testing.assert_allclose(np.mean(errors**2, axis=0), said, rtol=0.3)  # 150 draws: ±12 %


def test_white_noise_is_believed_where_stretches_scatter_less() -> None:
    """With the correlations that stretches have."""
    rng = np.random.default_rng(0)
    A = stretched(rng, 2)
    left = in_turn() + 0.01 * stretched(rng)
    left -= A @ np.linalg.lstsq(A, left, rcond=None)[0]
    one = Sheet(np.zeros((1, SAMPLES, 2)), A[None], (A @ [3.0, 0.5] + left)[None])
    found = solved([one], NOTHING_KNOWN).covariance
    bread = np.linalg.inv(A.T @ A)
    white = np.diag(bread) * np.mean(left**2)
    np.testing.assert_allclose(np.diag(found), white, rtol=1e-9)
    scores = of_stretches(A, left) @ bread
    together = scores.T @ scores
    size = np.sqrt(np.diag(together))
    np.testing.assert_allclose(found / np.sqrt(np.outer(white, white)),
                               together / np.outer(size, size), rtol=1e-6)  # fmt: skip


def of_lags(rng: np.random.Generator) -> tuple[Basis, np.ndarray]:
    """Rows of two drives, and slopes of two lags beside two columns of parameters."""
    Q, _ = np.linalg.qr(rng.standard_normal((2 * SAMPLES, 2)))
    basis = Basis(Q, np.zeros((2, 2)), np.ones(2))
    A = np.vstack([stretched(rng, 2), stretched(rng, 2)])
    return basis, basis.without(A)


def test_lags_err_by_the_scatter_of_both_drives_together() -> None:
    rng = np.random.default_rng(1)
    basis, A = of_lags(rng)
    left = np.tile(stretched(rng), 2)
    bread, scores = np.linalg.inv(A.T @ A), of_stretches(A, left)
    expected = bread @ scores.T @ scores @ bread * BLOCKS / (BLOCKS - 1)
    found = deviations(A, left, basis)
    np.testing.assert_allclose(found, np.sqrt(np.diag(expected)), rtol=1e-9)
    lag = Lag(np.zeros(2), found, np.zeros(2), left, left)
    t = stats.t.ppf(0.975, BLOCKS - 1)
    np.testing.assert_allclose(lag.interval, t * found, rtol=1e-9)


def test_lags_err_at_least_by_white_noise() -> None:
    basis, A = of_lags(np.random.default_rng(2))
    left = np.tile(in_turn(), 2)
    sigma2 = left @ left / (len(left) - 4)  # two parameters and two lags
    expected = np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * sigma2)
    np.testing.assert_allclose(deviations(A, left, basis), expected, rtol=1e-9)


def test_intervals_of_late_velocities_hold_the_truth_in_95_of_100() -> None:
    """As many drives as draws, each late by 2 ms; a part of the samples does not count."""
    rng, late, drives = np.random.default_rng(3), 2e-3, 1500
    slope, noise = np.sign(stretched(rng, drives)), 1e-3 * stretched(rng, drives)
    derived, counts = rng.standard_normal((SAMPLES, drives)), np.arange(SAMPLES) % LONG > 0
    wild = np.where(counts, 0.0, 1e3)[:, None]
    found = _lag(derived - late * slope + noise + wild, derived, slope, counts)
    inside = np.abs(found.values - late) < found.interval
    assert inside.mean() == pytest.approx(0.95, abs=0.02)
    # The mean of as many independent numbers as there are stretches.
    each = (slope * (slope * late - noise))[counts].reshape(BLOCKS, LONG - 1, drives).mean(axis=1)
    std = np.std(each, axis=0, ddof=1) / np.sqrt(BLOCKS)
    np.testing.assert_allclose(found.interval, stats.t.ppf(0.975, BLOCKS - 1) * std)


def of_zeros(rng: np.random.Generator, columns: int) -> Shifts:
    """Slopes of zeros, and scores of noise without any shift."""
    D = np.repeat(rng.standard_normal((OF_ZEROS, columns)), LONG, axis=0)
    e = np.repeat(rng.standard_normal(OF_ZEROS), LONG)
    scores = (D * e[:, None]).reshape(OF_ZEROS, LONG, columns).sum(axis=1)
    return Shifts(D.T @ D, scores, float(e @ e), len(e), columns, 0)


def test_a_zero_alone_errs_as_a_sum_of_its_blocks() -> None:
    told = of_zeros(np.random.default_rng(0), 1)
    value, covariance = told.told([0])
    s, H = told.scores[:, 0], told.H[0, 0]
    np.testing.assert_allclose(value, s.sum() / H)
    np.testing.assert_allclose(covariance, OF_ZEROS * np.var(s, ddof=1) / H**2)
    np.testing.assert_allclose(
        told.certainty([0]), abs(s.sum()) / np.sqrt(OF_ZEROS * s.var(ddof=1))
    )
    np.testing.assert_allclose(told.gain([0]), s.sum() ** 2 / H / told.left)


def test_zeros_beside_each_other_err_together() -> None:
    """By a sandwich with as many degrees of freedom less as there are columns in all."""
    told = of_zeros(np.random.default_rng(1), 3)
    s, bread = told.scores, np.linalg.inv(told.H)
    spread = np.cov(s.T) * OF_ZEROS * (OF_ZEROS - 1) / (OF_ZEROS - 3)
    at = np.ix_([0, 2], [0, 2])
    expected = (bread @ spread @ bread)[at]
    value, covariance = told.told([0, 2], [1])
    np.testing.assert_allclose(value, (bread @ s.sum(axis=0))[[0, 2]])
    np.testing.assert_allclose(covariance, expected)
    squared = value @ np.linalg.solve(expected, value) / 2  # a number of deviations each
    np.testing.assert_allclose(told.certainty([0, 2], [1]), np.sqrt(squared))


def test_zeros_err_as_they_say() -> None:
    rng = np.random.default_rng(2)
    found = [of_zeros(rng, 3).told([0], [1, 2]) for _ in range(400)]
    squares, said = np.mean([(v[0] ** 2, c[0, 0]) for v, c in found], axis=0)
    assert squares == pytest.approx(said, rel=0.25)  # 400 draws: ±7 %, few blocks: some more


@pytest.mark.parametrize("alike", [True, False])
def test_a_pattern_surprises_by_what_it_explains_over_the_scatter(alike: bool) -> None:
    """White noise is the least; one of a hundred tried surprises less."""
    rng = np.random.default_rng(6)
    columns = np.vstack([stretched(rng, 2), stretched(rng, 2)])
    Q, _ = np.linalg.qr(columns)
    noise = np.tile(stretched(rng) if alike else in_turn(), 2)
    noise -= Q @ (Q.T @ noise)
    left = 40.0 * Q[:, 0] + noise
    basis = Basis(np.zeros((len(left), 0)), np.zeros((1, 0)), np.ones(2))
    (one,) = account([Pattern("one", "", columns, tries=2.0)], lambda _: (), basis, left).first
    level = noise @ noise / (len(left) - 2)
    if alike:
        level = np.sum(of_stretches(Q, noise) ** 2) / 2
    # The probability that χ² with two degrees of freedom exceeds x is e^(−x/2).
    assert one.surprise == pytest.approx(0.5 * 1600 / level / np.log(10) - 2.0)


@pytest.mark.parametrize("alike", [True, False])
def test_columns_of_friction_are_judged_by_the_scatter_of_what_they_leave(alike: bool) -> None:
    rng = np.random.default_rng(7)
    Q, _ = np.linalg.qr(np.vstack([stretched(rng, 3), stretched(rng, 3)]))
    noise = np.tile(stretched(rng) if alike else in_turn(), 2)
    noise -= Q @ (Q.T @ noise)
    left, U = 20.0 * Q[:, 1] + noise, Q[:, 1:]
    rows = object.__new__(FrictionRows)  # of all that belongs to it only the basis counts
    object.__setattr__(rows, "basis", Basis(Q[:, :1], np.ones((1, 1)), np.ones(2)))
    found = rows.judged(U, left, constants=2)
    level = noise @ noise / (len(left) - 3)
    if alike:
        level = np.sum(of_stretches(U, noise) ** 2) / 2
    x = 400 / level
    np.testing.assert_allclose(found.after, noise, atol=1e-12)
    assert found.gain == pytest.approx(400 / (left @ left))
    assert found.times == pytest.approx(np.sqrt(x))
    # χ² with four degrees of freedom, two columns and two constants, exceeds x: (1 + x/2) e^(−x/2).
    assert found.surprise == pytest.approx((x / 2 - np.log1p(x / 2)) / np.log(10))
