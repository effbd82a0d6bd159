"""Variances that a covariance is given: those asked for, and sums that stay sharp."""

import numpy as np

from deltaid.identification.marginal import with_variances


def test_variances_change_and_sharp_sums_stay() -> None:
    rng = np.random.default_rng(0)
    half = rng.standard_normal((6, 6)) * np.geomspace(1, 0.1, 6)
    V = half @ half.T
    wanted = np.diag(V) * rng.uniform(0.9, 1.3, 6)
    found = with_variances(V, wanted)
    np.testing.assert_allclose(np.diag(found), wanted, rtol=0.02)
    difference = np.linalg.inv(found) - np.linalg.inv(V) / np.exp(
        np.mean(np.log(wanted / np.diag(V)))
    )
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
