"""A linear problem as a value: rank, what is known before, variances, instruments, groups."""

import numpy as np
import pytest

from deltaid.estimation.drive_rows import STRETCHES, DriveRows, stretch_numbers, stretch_starts
from deltaid.estimation.problem import KNOWN, LinearProblem, Span, group_sums
from deltaid.identification.judgement import with_variances


@pytest.mark.parametrize("samples", [1, STRETCHES - 1, STRETCHES, 97])
def test_stretches_of_a_short_recording_lie_in_it(samples: int) -> None:
    starts = stretch_starts(samples)
    assert starts[0] == 0
    assert np.all(np.diff(starts) > 0)
    assert starts[-1] < samples
    assert len(starts) == min(samples, STRETCHES)
    numbers = stretch_numbers(samples)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(numbers, prepend=-1)), starts)


def test_a_span_finds_its_rank_and_leaves_dependent_columns_the_shortest() -> None:
    """Against NumPy's pseudo-inverse, of columns of sizes that are nine decades apart."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((50, 4)) * [1.0, 1e-4, 1e5, 1.0]
    A = np.column_stack([A, A[:, 0] + A[:, 2], np.zeros(50)])
    span, b = Span.of_columns(A), rng.standard_normal(50)
    assert span.rank == 4
    norms = np.linalg.norm(A, axis=0)
    norms[-1] = 1.0
    expected = np.linalg.pinv(A / norms, rcond=1e-9) @ b / norms
    np.testing.assert_allclose(span.coefficients(b), expected, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(A.T @ span.without(b) / norms, 0.0, atol=1e-9)


def test_further_columns_widen_a_span_as_far_as_they_are_new() -> None:
    rng = np.random.default_rng(1)
    A, B = rng.standard_normal((30, 3)), rng.standard_normal((30, 2))
    wide = Span.of_columns(A).with_columns(np.column_stack([B, A[:, 0] - B[:, 1]]))
    assert wide.rank == 5
    np.testing.assert_allclose(wide.without(np.column_stack([A, B])), 0.0, atol=1e-12)
    b = rng.standard_normal(30)
    np.testing.assert_allclose(wide.coefficients(b), np.linalg.lstsq(A, b, rcond=None)[0])


def test_rows_of_groups_are_summed_in_any_order() -> None:
    rows = np.arange(12.0).reshape(6, 2)
    found = group_sums(rows, np.array([2, 0, 2, 0, 1, 1]))
    np.testing.assert_array_equal(found, [rows[1] + rows[3], rows[4] + rows[5], rows[0] + rows[2]])


def of_two_drives(rng: np.random.Generator, samples: int, noise: float) -> LinearProblem:
    """Rows of two drives of x = (2, −1, 3), the second with ten times the noise."""
    A = rng.standard_normal((2, samples, 3))
    level = noise * np.array([[1.0], [10.0]])
    b = A @ [2.0, -1.0, 3.0] + level * rng.standard_normal((2, samples))
    return DriveRows.by_noise(A, b).problem(A, b)


def test_what_is_not_known_before_errs_as_its_covariance_says() -> None:
    rng, known = np.random.default_rng(3), (np.eye(2, 3), np.array([2.0, -1.0]))
    parts = ([of_two_drives(rng, size, 0.1) for size in (39, 300)] for _ in range(600))
    found = [LinearProblem.together(part).with_known(*known) for part in parts]
    errors = np.array([solution.x[2] - 3.0 for solution in found])
    deviations = np.array([solution.covariance(slice(2, 3))[0, 0] ** 0.5 for solution in found])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.1 / np.sqrt(339), rel=0.2)
    assert np.mean(deviations) == pytest.approx(np.std(errors), rel=0.2)


def test_what_is_known_before_counts_by_its_deviation() -> None:
    rows = DriveRows(np.ones(1), 4).problem(np.zeros((1, 4, 2)), np.ones((1, 4)))
    found = rows.with_known(np.diag([2.0, 10.0]), np.array([14.0, 5.0]))
    np.testing.assert_allclose(found.x, [7.0, 0.5])
    np.testing.assert_allclose(found.covariance(), np.diag([0.25, 0.01]))
    assert found.measured == 4.0


def test_instruments_are_not_biased_by_noise_that_columns_share_with_the_right_side() -> None:
    rng = np.random.default_rng(4)
    clean, noise = rng.standard_normal((1, 4000, 2)), rng.standard_normal((1, 4000))
    A, b = clean + 0.5 * noise[:, :, None], clean @ [2.0, 3.0] + noise
    rows, known = DriveRows.by_noise(A, b), (np.array([[1e-6, 0.0]]), np.zeros(1))
    biased = rows.problem(A, b).with_known(*known)
    right = rows.problem(A, b, [clean]).with_known(*known)
    assert abs(right.x[1] - 3.0) < 3 * right.covariance()[1, 1] ** 0.5
    assert abs(biased.x[1] - 3.0) > 5 * biased.covariance()[1, 1] ** 0.5
    np.testing.assert_allclose(right.x[0], 2.0, atol=0.2)


def test_two_sets_of_instruments_are_two_stages_of_least_squares() -> None:
    rng = np.random.default_rng(5)
    first, second, A = (rng.standard_normal((1, 60, 2)) for _ in range(3))
    A, b = A + first + second, rng.standard_normal((1, 60))
    found = DriveRows(np.array([0.5]), 60).problem(A, b, [first, second])
    Z = np.hstack([first[0], second[0]])
    by_instruments = Z @ np.linalg.lstsq(Z, A[0], rcond=None)[0]
    np.testing.assert_allclose(found.x, np.linalg.lstsq(by_instruments, b[0], rcond=None)[0])


def test_recordings_have_groups_of_their_own() -> None:
    A, b = np.ones((3, 1)), np.ones(3)
    problem = LinearProblem(A, b, np.array([0, 0, 1])).with_known(A[:1], b[:1])
    both = LinearProblem.together([problem, LinearProblem(A, b, np.array([0, 1, 1]))])
    np.testing.assert_array_equal(both.groups, [0, 0, 1, KNOWN, 2, 3, 3])
    assert both.measured == 6.0


def test_variances_change_and_sharp_sums_stay() -> None:
    rng = np.random.default_rng(0)
    half = rng.standard_normal((6, 6)) * np.geomspace(1, 0.1, 6)
    V = half @ half.T
    wanted = np.diag(V) * rng.uniform(0.9, 1.3, 6)
    found = with_variances(V, wanted)
    np.testing.assert_allclose(np.diag(found), wanted, rtol=0.02)
    grown = np.exp(np.mean(np.log(wanted / np.diag(V))))
    difference = np.linalg.inv(found) - np.linalg.inv(V) / grown
    off = difference - np.diag(np.diag(difference))
    assert np.abs(off).max() < 1e-6 * np.abs(np.linalg.inv(V)).max()


def test_variances_are_had_where_sums_are_known_far_better() -> None:
    """Correlations whose least eigenvalue is 1e-11, as of parameters that torques tell as sums."""
    rng = np.random.default_rng(3)
    Q, _ = np.linalg.qr(rng.standard_normal((30, 30)))
    V = (Q * np.geomspace(1e-11, 3.0, 30)) @ Q.T
    wanted = np.diag(V) * rng.uniform(0.9, 1.2, 30)
    found = with_variances(V, wanted)
    np.testing.assert_allclose(np.diag(found), wanted, rtol=0.1)
    assert np.linalg.eigvalsh(found)[0] > 0
