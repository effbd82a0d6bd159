"""What the drives of a robot tell of each other.

Drives of a robot are alike and hang in the same hall: how friction follows temperature, and how it
scatters from day to day, are nearly the same. So what the others show of that is what is known of a
drive before it is looked at. A drive that drifts says little to the others: its coefficients count
as far as they are known with a change and without.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from deltaid.drift.evidence import Changes, Evidence, Prior, evidence
from deltaid.drift.wander import Scatter, Sums

# Changes that a drive is expected to have in a year.
_A_YEAR = 0.2
# What others show of scatter counts by this power, for they are disturbed together.
_TOGETHER = 0.7


def first_prior(scale: Float[np.ndarray, " regressors"], scatter: Scatter, series: int) -> Prior:
    """What is known of any drive.

    Args:
        scale: standard deviations of coefficients in units of σ.
    """
    p = len(scale)
    log = np.log(scatter.usual)
    return Prior(
        np.zeros((series, p)),
        np.broadcast_to(np.diag(scale**-2.0), (series, p, p)),
        np.repeat(log[:, None], series, axis=1),
    )


def together(
    sums: Sums,
    changes: Changes,
    prior: Prior,
    unlike: Float[np.ndarray, " regressors"],
    drives: int,
) -> Evidence:
    """Evidence of all series, each with what the others of its robot show.

    Args:
        prior: of each by itself.
        unlike: standard deviation between drives of one robot; infinite where nothing is common.
        drives: series of one robot, which follow each other.
    """
    alone = evidence(sums, changes, prior)
    if drives == 1:
        return alone
    return evidence(sums, changes, _with_others(alone, changes, prior, unlike, drives))


def _with_others(
    alone: Evidence,
    changes: Changes,
    prior: Prior,
    unlike: Float[np.ndarray, " regressors"],
    drives: int,
) -> Prior:
    changed = _A_YEAR * alone.R / (1.0 + _A_YEAR * alone.R)
    kinds = alone.log_none - prior.log_kinds
    some = logsumexp(alone.log_factor, axis=(0, 3)) + np.log(changes.years)
    kinds = kinds + np.logaddexp(0.0, np.log(_A_YEAR) + some)
    own = kinds.reshape(len(kinds), -1, drives)
    others = (own.sum(axis=2, keepdims=True) - own).reshape(kinds.shape)
    log = prior.log_kinds + _TOGETHER * others
    mean, covariance = _moments(alone, changed)
    at = np.flatnonzero(np.isfinite(unlike))
    if not at.size:
        return replace(prior, log_kinds=log - logsumexp(log, axis=0))
    spread = np.diag(unlike[at] ** 2)
    grid = np.ix_(np.arange(len(mean)), at, at)
    W = np.linalg.inv(covariance[grid] + spread).reshape(-1, drives, len(at), len(at))
    Wb = np.einsum("rdpq,rdq->rdp", W, mean[:, at].reshape(-1, drives, len(at)))
    sigma2 = np.sum(alone.of_kinds * alone.sigma**2, axis=0)
    start = (prior.precision[grid] / sigma2[:, None, None]).reshape(W.shape)
    known = W.sum(axis=1, keepdims=True) - W + start
    covariance = np.linalg.inv(known)
    middle = np.einsum("rdpq,rdq->rdp", covariance, Wb.sum(axis=1, keepdims=True) - Wb)
    found, precision = prior.mean.copy(), prior.precision.copy()
    found[:, at] = middle.reshape(-1, len(at))
    inverse = np.linalg.inv(covariance + spread).reshape(-1, len(at), len(at))
    precision[grid] = inverse * sigma2[:, None, None]
    return Prior(found, precision, log - logsumexp(log, axis=0))


def _moments(
    found: Evidence, changed: Float[np.ndarray, " series"]
) -> tuple[
    Float[np.ndarray, "series regressors"], Float[np.ndarray, "series regressors regressors"]
]:
    """Mean and covariance of coefficients, with and without a change."""
    w, none = found.of_changes.sum(axis=0) * changed[:, None], found.of_kinds * (1.0 - changed)
    moved = found.plain[..., None] - found.per_size * found.size[..., None, :]
    mean = np.einsum("ks,ksp->sp", none, found.plain) + np.einsum("ksa,kspa->sp", w, moved)
    apart, away = found.plain - mean, moved - mean[..., None]
    covariance = (
        np.einsum("ks,kspq->spq", none + w.sum(axis=2), found.covariance)
        + np.einsum("ks,ksp,ksq->spq", none, apart, apart)
        + np.einsum("ksa,kspa,ksqa->spq", w, away, away, optimize=True)
        + np.einsum("ksa,kspa,ksqa->spq", w * found.deviation**2, found.per_size, found.per_size,
                    optimize=True)
    )  # fmt: skip
    return mean, covariance
