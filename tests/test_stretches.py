"""How certain something is by the scatter between stretches of time, against formulas written out.

Noise here is the same in all samples of a stretch, and in all drives, as that of a wrong model is:
taken for white it would be far too small.
"""

import numpy as np
import pytest
from scipy import stats

from deltaid.checks.wiring.zeros import BLOCKS as OF_ZEROS
from deltaid.checks.wiring.zeros import Shifts
from deltaid.effects.account import account
from deltaid.effects.point import EffectCandidate
from deltaid.estimation.drive_rows import STRETCHES, DriveRows
from deltaid.estimation.problem import LinearProblem, Span
from deltaid.identification.column_stages import rate_lag
from deltaid.identification.friction_rows import FrictionRows

LONG = 4  # samples a stretch
SAMPLES = STRETCHES * LONG


def stretched(rng: np.random.Generator, *columns: int) -> np.ndarray:
    """Numbers that stay as they are within a stretch."""
    return np.repeat(rng.standard_normal((STRETCHES, *columns)), LONG, axis=0)


def in_turn() -> np.ndarray:
    """Noise of which nothing is left in the sum over a stretch."""
    return np.tile([1.0, -1.0], SAMPLES // 2)


def of_stretches(rows: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Sums over each stretch of all drives, of rows times what is left: (stretches, columns)."""
    return (rows * left[:, None]).reshape(-1, STRETCHES, LONG, rows.shape[1]).sum(axis=(0, 2))


def recorded(rng: np.random.Generator) -> LinearProblem:
    """Rows of two drives of x = (2, −1, 3, 0.5), the last two of which go on for a stretch."""
    A = rng.standard_normal((2, SAMPLES, 4))
    A[:, :, 2:] = [stretched(rng, 2) for _ in range(2)]
    b = A @ [2.0, -1.0, 3.0, 0.5] + stretched(rng)
    return DriveRows.by_noise(A, b).problem(A, b)


def clustered(parts: list[LinearProblem]) -> tuple[np.ndarray, np.ndarray]:
    """x by least squares, and its covariance (Liang and Zeger's, n/(n − 1) for n stretches)."""
    A, b = np.vstack([part.A for part in parts]), np.concatenate([part.b for part in parts])
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    sums = np.vstack([of_stretches(part.A, part.b - part.A @ x) for part in parts])
    bread, n = np.linalg.inv(A.T @ A), len(sums)
    return x, bread @ sums.T @ sums @ bread * n / (n - 1)


@pytest.mark.parametrize("recordings", [1, 2])
def test_a_linear_problem_has_the_covariance_of_clusters(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    parts = [recorded(rng) for _ in range(recordings)]
    x, covariance = clustered(parts)
    found, at = LinearProblem.together(parts), np.ix_([2, 3], [2, 3])
    np.testing.assert_allclose(found.x, x, rtol=1e-9)
    np.testing.assert_allclose(found.covariance()[at], covariance[at], rtol=1e-8)
    np.testing.assert_allclose(found.covariance(slice(2, 4)), covariance[at], rtol=1e-8)


def test_a_linear_problem_errs_as_its_scatter_says() -> None:
    rng = np.random.default_rng(5)
    found = [recorded(rng) for _ in range(600)]
    errors = np.array([solution.x[2:] for solution in found]) - [3.0, 0.5]
    said = np.mean([np.diag(solution.covariance(slice(2, 4))) for solution in found], axis=0)
    np.testing.assert_allclose(np.mean(errors**2, axis=0), said, rtol=0.2)  # 600 draws: ±6 %


def test_white_noise_is_believed_where_stretches_scatter_less() -> None:
    """With the correlations that stretches have."""
    rng = np.random.default_rng(0)
    A = stretched(rng, 2)
    left = in_turn() + 0.01 * stretched(rng)
    left -= A @ np.linalg.lstsq(A, left, rcond=None)[0]
    rows = DriveRows(np.ones(1), SAMPLES)
    found = rows.problem(A[None], (A @ [3.0, 0.5] + left)[None]).covariance()
    bread = np.linalg.inv(A.T @ A)
    white = np.diag(bread) * (left @ left) / (SAMPLES - 2)
    np.testing.assert_allclose(np.diag(found), white, rtol=1e-9)
    scores = of_stretches(A, left) @ bread
    together = scores.T @ scores
    size = np.sqrt(np.diag(together))
    np.testing.assert_allclose(found / np.sqrt(np.outer(white, white)),
                               together / np.outer(size, size), rtol=1e-6)  # fmt: skip


ROWS = DriveRows(np.ones(2), SAMPLES)


def test_intervals_of_late_velocities_hold_the_truth_in_95_of_100() -> None:
    """As many drives as draws, each late by 2 ms; a part of the samples does not count."""
    rng, late, drives = np.random.default_rng(3), 2e-3, 1500
    slope, noise = np.sign(stretched(rng, drives)), 1e-3 * stretched(rng, drives)
    derived, counts = rng.standard_normal((SAMPLES, drives)), np.arange(SAMPLES) % LONG > 0
    wild = np.where(counts, 0.0, 1e3)[:, None]
    found = rate_lag(derived - late * slope + noise + wild, derived, slope, counts)
    inside = np.abs(found.values - late) < found.interval
    assert inside.mean() == pytest.approx(0.95, abs=0.02)
    # The mean of as many independent numbers as there are stretches.
    each = (slope * (slope * late - noise))[counts].reshape(STRETCHES, LONG - 1, drives)
    std = np.std(each.mean(axis=1), axis=0, ddof=1) / np.sqrt(STRETCHES)
    np.testing.assert_allclose(found.interval, stats.t.ppf(0.975, STRETCHES - 1) * std)


def of_zeros(rng: np.random.Generator, columns: int) -> Shifts:
    """Slopes of zeros, and scores of noise without any shift."""
    D = np.repeat(rng.standard_normal((OF_ZEROS, columns)), LONG, axis=0)
    e = np.repeat(rng.standard_normal(OF_ZEROS), LONG)
    scores = (D * e[:, None]).reshape(OF_ZEROS, LONG, columns).sum(axis=1)
    return Shifts(D.T @ D, scores, float(e @ e), len(e), columns, 0)


def test_a_zero_alone_errs_as_a_sum_of_its_blocks() -> None:
    shift = of_zeros(np.random.default_rng(0), 1)
    value, covariance = shift.estimate([0])
    s, H = shift.scores[:, 0], shift.H[0, 0]
    np.testing.assert_allclose(value, s.sum() / H)
    np.testing.assert_allclose(covariance, OF_ZEROS * np.var(s, ddof=1) / H**2)
    np.testing.assert_allclose(
        shift.certainty([0]), abs(s.sum()) / np.sqrt(OF_ZEROS * s.var(ddof=1))
    )
    np.testing.assert_allclose(shift.gain([0]), s.sum() ** 2 / H / shift.squares)


def test_zeros_beside_each_other_err_together() -> None:
    """By a sandwich with as many degrees of freedom less as there are columns in all."""
    shifts = of_zeros(np.random.default_rng(1), 3)
    s, bread = shifts.scores, np.linalg.inv(shifts.H)
    spread = np.cov(s.T) * OF_ZEROS * (OF_ZEROS - 1) / (OF_ZEROS - 3)
    at = np.ix_([0, 2], [0, 2])
    expected = (bread @ spread @ bread)[at]
    value, covariance = shifts.estimate([0, 2], [1])
    np.testing.assert_allclose(value, (bread @ s.sum(axis=0))[[0, 2]])
    np.testing.assert_allclose(covariance, expected)
    squared = value @ np.linalg.solve(expected, value) / 2  # a number of deviations each
    np.testing.assert_allclose(shifts.certainty([0, 2], [1]), np.sqrt(squared))


def test_zeros_err_as_they_say() -> None:
    rng = np.random.default_rng(2)
    found = [of_zeros(rng, 3).estimate([0], [1, 2]) for _ in range(400)]
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
    span, pattern = Span.of_columns(0 * columns), EffectCandidate("one", "", columns, tries=2.0)
    (step,) = account([pattern], lambda _: (), ROWS.groups, span, left).first
    level = noise @ noise / (len(left) - 2)
    if alike:
        level = np.sum(of_stretches(Q, noise) ** 2) / 2 * STRETCHES / (STRETCHES - 1)
    # The probability that χ² with two degrees of freedom exceeds x is e^(−x/2).
    assert step.surprise == pytest.approx(0.5 * 1600 / level / np.log(10) - 2.0)


@pytest.mark.parametrize("alike", [True, False])
def test_columns_of_friction_are_judged_by_the_scatter_of_what_they_leave(alike: bool) -> None:
    rng = np.random.default_rng(7)
    Q, _ = np.linalg.qr(np.vstack([stretched(rng, 3), stretched(rng, 3)]))
    noise = np.tile(stretched(rng) if alike else in_turn(), 2)
    noise -= Q @ (Q.T @ noise)
    left, U = 20.0 * Q[:, 1] + noise, Q[:, 1:]
    rows = object.__new__(FrictionRows)  # of all that belongs to it only these count
    span = Span(Q[:, :1], np.ones((1, 1)))
    rows.__dict__.update(drive_rows=ROWS, span=span, largest=np.ones(2))
    found = rows.judged(U, left, constants=2)
    level = noise @ noise / (len(left) - 3)
    if alike:
        level = np.sum(of_stretches(U, noise) ** 2) / 2 * STRETCHES / (STRETCHES - 1)
    x = 400 / level
    assert found.error == pytest.approx(np.sqrt(np.mean(noise**2)))
    assert found.gain == pytest.approx(400 / (left @ left))
    assert found.times == pytest.approx(np.sqrt(x))
    # χ² with four degrees of freedom, two columns and two constants, exceeds x: (1 + x/2) e^(−x/2).
    assert found.surprise == pytest.approx((x / 2 - np.log1p(x / 2)) / np.log(10))
