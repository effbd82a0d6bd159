"""Bayes factors of a change in a series against none, and an alarm from them.

A series in percent, y = X b + u with scatter u, may have a change d h_k(t): a ramp or a step from
the onset k. b and d are normal with standard deviations in units of σ; σ² is inverse gamma with few
degrees of freedom. All of them are integrated in closed form, and kinds of scatter and onsets
summed.

**Alarm.** For an onset k the Bayes factor B_k(n) after recording n is 1 before k and a martingale
as long as nothing changes. So with onsets spread over time,

    R(n) = Σ_k (time between onsets, in years) Σ_kinds of change π B_k(n),

minus the elapsed years is a martingale, and by Doob's inequality

    P(R ever reaches A within Y years) ≤ Y / A,

for any number of evaluations. The alarm is R ≥ A, with A the years per false alarm of a drive.

**Few recordings.** The prior of σ then dominates. With the prior dσ/σ instead, B_k depends only on
ratios of the recordings, as Student's t does, and is a martingale for any σ. So for few recordings
the alarm uses the smaller of both R: one recording on each side of a change cannot raise it, four
can. Each recording counts as at least a month, the first eleven as at most a year, so a robot has
no more false alarms in these than in a year.

**Drives of a robot** are similar and share their surroundings: temperature dependence and daily
scatter of friction are nearly the same, so the other drives determine the prior of a drive.
Coefficients of a drifting drive are averaged over models with and without a change.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy import constants
from scipy.linalg import inv
from scipy.special import logsumexp, stdtr

from deltaid.fleets.drift_scatter import DailyScatter, WhiteSums

# Prior of σ: degrees of freedom, and size [%].
FREEDOM, SIZE = 4.0, 1.0
# Kinds of change with prior probabilities: a ramp upwards, a ramp downwards, a step each way.
KINDS = (("rising", 0.6), ("falling", 0.1), ("stepped", 0.2), ("stepped", 0.1))
# Standard deviations of the slope of a ramp [% a month] and of a step [%], in units of σ.
RAMP, STEP = 2.5, 6.0
# Deviation of a steep ramp's slope in the same unit, the only ramp that few recordings determine,
# and the share of ramps that are steep: drives seldom fail within weeks.
STEEP, SELDOM = 25.0, 0.1
# Lengths of a week, a year and a month on average [days].
WEEK, YEAR = constants.week / constants.day, constants.Julian_year / constants.day
MONTH = YEAR / 12
# Number of recordings below which σ has no prior, and a change may begin with any of them.
FEWEST = 12
# Largest number of onsets, which are a week apart at least.
_MOST = 60
# Expected changes of a drive per year.
_A_YEAR = 0.2
# Exponent of the other drives' evidence on scatter: below 1, because disturbances are correlated.
_TOGETHER = 0.7


@dataclass(frozen=True, eq=False)
class Changes:
    """Candidate changes: ramps, then steps.

    Attributes:
        onsets: first day of each [days].
        columns: effect of each on the series, for 1 % a month or 1 %.
        scale: standard deviation of its size in units of σ.
        share: its prior share of the changes of its kind with this onset.
        years: time between onsets.
    """

    onsets: Float[np.ndarray, " alternatives"]
    columns: Float[np.ndarray, "n alternatives"]
    scale: Float[np.ndarray, " alternatives"]
    share: Float[np.ndarray, " alternatives"]
    years: float

    @classmethod
    def over(cls, days: Float[np.ndarray, " n"]) -> "Changes":
        """Changes that recordings on these days can determine."""
        span = float(days[-1] - days[0])
        spacing = max(WEEK, span / _MOST)
        onsets = days[0] + np.arange(0.0, max(span, spacing), spacing)
        ramps = {RAMP: 1.0 - SELDOM, STEEP: SELDOM}
        if len(days) < FEWEST:
            onsets, spacing, ramps = np.unique(days), max(spacing, MONTH), {STEEP: 1.0}
        since, count = days[:, None] - onsets, len(onsets)
        counts = [*[count] * len(ramps), count - 1]
        return cls(
            onsets=np.concatenate([*[onsets] * len(ramps), onsets[1:]]),
            columns=np.hstack([*[np.maximum(since, 0.0) / MONTH] * len(ramps), since[:, 1:] >= 0]),
            scale=np.repeat([*ramps, STEP], counts),
            share=np.repeat([*ramps.values(), 1.0], counts),
            years=spacing / YEAR,
        )

    @classmethod
    def steps(cls, days: Float[np.ndarray, " n"]) -> "Changes":
        """Steps at each recording, for steps large enough to determine the day."""
        onsets = days[1:]
        return cls(
            onsets=onsets,
            columns=(days[:, None] >= onsets).astype(float),
            scale=np.full(len(onsets), STEP),
            share=np.ones(len(onsets)),
            years=float(days[-1] - days[0]) / len(onsets) / YEAR,
        )

    @property
    def is_ramp(self) -> np.ndarray:
        return self.scale != STEP


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of a series: mean of b, inverse of its covariance in units of σ², and log probabilities
    of kinds of scatter."""

    mean: Float[np.ndarray, "series regressors"]
    precision: Float[np.ndarray, "series regressors regressors"]
    log_kinds: Float[np.ndarray, "kinds series"]


@dataclass(frozen=True, eq=False)
class ChangeEvidence:
    """Evidence of recordings for changes.

    Attributes:
        log_none: log evidence of no change with each kind of scatter, prior included.
        log_factor: log Bayes factor of each change, up and down, prior included.
        size: expected size of each change, for either sign.
        deviation: standard deviation of the size.
        freedom: degrees of freedom of its Student distribution.
        plain: coefficients b without a change.
        per_size: their decrease for a change of size 1.
        covariance: of b for a known change.
        sigma: σ without a change.
        R: statistic of the alarm [years].
    """

    log_none: Float[np.ndarray, "kinds series"]
    log_factor: Float[np.ndarray, "2 kinds series alternatives"]
    size: Float[np.ndarray, "kinds series alternatives"]
    deviation: Float[np.ndarray, "kinds series alternatives"]
    freedom: Float[np.ndarray, " series"]
    plain: Float[np.ndarray, "kinds series regressors"]
    per_size: Float[np.ndarray, "kinds series regressors alternatives"]
    covariance: Float[np.ndarray, "kinds series regressors regressors"]
    sigma: Float[np.ndarray, "kinds series"]
    R: Float[np.ndarray, " series"]

    @property
    def of_kinds(self) -> Float[np.ndarray, "kinds series"]:
        """Probability of each kind of scatter without a change."""
        return np.exp(self.log_none - logsumexp(self.log_none, axis=0))

    @property
    def of_changes(self) -> Float[np.ndarray, "2 kinds series alternatives"]:
        """Probability of each change, given that one exists."""
        log = self.log_factor + self.log_none[None, :, :, None]
        return np.exp(log - logsumexp(log, axis=(0, 1, 3), keepdims=True))


def evidence(
    sums: WhiteSums, changes: Changes, prior: Prior, freedom: float = FREEDOM
) -> ChangeEvidence:
    """Evidence of all changes, with the prior degrees of freedom of σ."""
    p, nu = prior.mean.shape[1], np.maximum(freedom + sums.count - 1.0, 1.0)
    X, b, C = np.split(sums.products[..., :p, :], [p, p + 1], axis=-1)
    b, A = b[..., 0], X + prior.precision
    # Series minus their prior mean.
    centred = b - np.einsum("kspq,sq->ksp", X, prior.mean)
    yy = sums.products[..., p, p] - np.einsum("ksp,sp->ks", b + centred, prior.mean)
    inverse = inv(A, assume_a="pos")
    shift = np.einsum("kspq,ksq->ksp", inverse, centred)
    plain, per_size = shift + prior.mean, inverse @ C
    r = freedom * SIZE**2 + yy - np.einsum("ksp,ksp->ks", centred, shift)
    r = np.maximum(r, 1e-12)
    a = sums.squares - np.einsum("kspa,kspa->ksa", C, per_size)
    c = sums.products[..., p, p + 1 :] - np.einsum("kspa,ksp->ksa", C, plain)
    log_none = prior.log_kinds - 0.5 * (sums.log_det + np.linalg.slogdet(A)[1] + nu * np.log(r))
    a_known = np.maximum(a, 0.0) + changes.scale**-2.0
    rest = np.maximum(r[..., None] - c**2 / a_known, 1e-12)
    gain = -0.5 * (np.log(a_known * changes.scale**2) + nu[:, None] * np.log(rest / r[..., None]))
    size, deviation = c / a_known, np.sqrt(rest / nu[:, None] / a_known)
    up = stdtr(nu[:, None], np.stack([size, -size]) / deviation)
    shares = np.array([share for _, share in KINDS])
    kinds = np.where(changes.is_ramp, shares[:2, None], shares[2:, None]) * changes.share
    with np.errstate(divide="ignore"):
        log_factor = gain + np.log(2.0 * up) + np.log(kinds)[:, None, None]
    log = log_factor + log_none[None, :, :, None]
    R = logsumexp(log, axis=(0, 1, 3)) - logsumexp(log_none, axis=0) + np.log(changes.years)
    return ChangeEvidence(
        log_none, log_factor, size, deviation, nu, plain, per_size,
        covariance=inverse * (r / nu)[..., None, None],
        sigma=np.sqrt(r / nu),
        R=np.exp(np.minimum(R, 600.0)),
    )  # fmt: skip


def first_prior(
    scale: Float[np.ndarray, " regressors"], scatter: DailyScatter, series: int
) -> Prior:
    """Prior of any drive, from standard deviations of coefficients in units of σ."""
    p = len(scale)
    precision = np.broadcast_to(np.diag(scale**-2.0), (series, p, p))
    return Prior(
        mean=np.zeros((series, p)),
        precision=precision,
        log_kinds=np.repeat(np.log(scatter.usual)[:, None], series, axis=1),
    )


def with_others(
    alone: ChangeEvidence,
    changes: Changes,
    prior: Prior,
    between_drives: Float[np.ndarray, " regressors"],
    drives: int,
) -> Prior:
    """Prior of each drive from the other drives of its robot.

    Args:
        alone: evidence of each drive by itself, with `prior`.
        between_drives: standard deviation between drives of one robot; infinite if independent.
        drives: number of consecutive series of one robot.
    """
    changed = _A_YEAR * alone.R / (1.0 + _A_YEAR * alone.R)
    kinds = alone.log_none - prior.log_kinds
    some = logsumexp(alone.log_factor, axis=(0, 3)) + np.log(changes.years)
    kinds = kinds + np.logaddexp(0.0, np.log(_A_YEAR) + some)
    by_robot = kinds.reshape(len(kinds), -1, drives)
    others = (by_robot.sum(axis=2, keepdims=True) - by_robot).reshape(kinds.shape)
    log = prior.log_kinds + _TOGETHER * others
    mean, covariance = _moments(alone, changed)
    common = np.flatnonzero(np.isfinite(between_drives))
    prior = replace(prior, log_kinds=log - logsumexp(log, axis=0))
    if not common.size:
        return prior
    spread = np.diag(between_drives[common] ** 2)
    grid = np.ix_(np.arange(len(mean)), common, common)
    W = inv(covariance[grid] + spread, assume_a="pos")
    W = W.reshape(-1, drives, len(common), len(common))
    Wb = np.einsum("rdpq,rdq->rdp", W, mean[:, common].reshape(-1, drives, len(common)))
    sigma2 = np.sum(alone.of_kinds * alone.sigma**2, axis=0)
    start = (prior.precision[grid] / sigma2[:, None, None]).reshape(W.shape)
    covariance = inv(W.sum(axis=1, keepdims=True) - W + start, assume_a="pos")
    middle = np.einsum("rdpq,rdq->rdp", covariance, Wb.sum(axis=1, keepdims=True) - Wb)
    means, precision = prior.mean.copy(), prior.precision.copy()
    means[:, common] = middle.reshape(-1, len(common))
    inverse = inv(covariance + spread, assume_a="pos")
    inverse = inverse.reshape(-1, len(common), len(common))
    precision[grid] = inverse * sigma2[:, None, None]
    return replace(prior, mean=means, precision=precision)


def _moments(
    e: ChangeEvidence, changed: Float[np.ndarray, " series"]
) -> tuple[
    Float[np.ndarray, "series regressors"], Float[np.ndarray, "series regressors regressors"]
]:
    w, none = e.of_changes.sum(axis=0) * changed[:, None], e.of_kinds * (1.0 - changed)
    moved = e.plain[..., None] - e.per_size * e.size[..., None, :]
    mean = np.einsum("ks,ksp->sp", none, e.plain) + np.einsum("ksa,kspa->sp", w, moved)
    off, away = e.plain - mean, moved - mean[..., None]
    covariance = (
        np.einsum("ks,kspq->spq", none + w.sum(axis=2), e.covariance)
        + np.einsum("ks,ksp,ksq->spq", none, off, off)
        + np.einsum("ksa,kspa,ksqa->spq", w, away, away, optimize=True)
        + np.einsum("ksa,kspa,ksqa->spq", w * e.deviation**2, e.per_size, e.per_size,
                    optimize=True)
    )  # fmt: skip
    return mean, covariance
