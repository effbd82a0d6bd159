"""How much better a change explains a series than none: Bayes factors, and an alarm from them.

A series in percent, y = X b + u, u of a kind of scatter, has beside that a change d h_k(t): a ramp
or a step from onset k. b and d: normal with standard deviations in
units of σ; σ² inverse gamma with few degrees of freedom. All of them are integrated in closed form,
kinds of scatter and onsets are summed over.

**Alarm.** For an onset k the Bayes factor B_k(n), after the recordings up to n, is 1 before k and a
martingale as long as nothing changes. So with onsets spread over time,

    R(n) = Σ_k (time between onsets, in years) Σ_kinds of change π B_k(n),

minus the years that have passed is a martingale, and by Doob's inequality

    P(R ever reaches A within Y years) ≤ Y / A,

however often one looks. The alarm is R ≥ A with A the years a drive may run for one false alarm.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, stdtr

from deltaid.drift.wander import Sums

# Of σ before any recording [%]: degrees of freedom and size.
FREEDOM, SIZE = 4.0, 1.0
# Kinds of change with how usual they are: a ramp upwards, a ramp downwards, a step each way.
KINDS = (("rising", 0.6), ("falling", 0.1), ("stepped", 0.2), ("stepped", 0.1))
# Standard deviations of the slope of a ramp [% a month] and of a step [%], in units of σ.
RAMP, STEP = 2.5, 6.0
MONTH, YEAR = 30.4375, 365.25
# Onsets lie a week apart, or so many in all.
_APART, _MOST = 7.0, 60


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes that are tried.

    Attributes:
        onsets: when each begins [days]; those of ramps, then the same for steps.
        columns: what each does to the series, for 1 % a month or 1 %.
        scale: standard deviation of its size in units of σ.
        years: time between onsets.
    """

    onsets: Float[np.ndarray, " alternatives"]
    columns: Float[np.ndarray, "n alternatives"]
    scale: Float[np.ndarray, " alternatives"]
    years: float

    @classmethod
    def over(cls, days: Float[np.ndarray, " n"]) -> "Changes":
        """Those that recordings at such days can tell."""
        span = float(days[-1] - days[0])
        apart = max(_APART, span / _MOST)
        onsets = days[0] + np.arange(0.0, max(span, apart), apart)
        since = days[:, None] - onsets
        ramps, steps = np.maximum(since, 0.0) / MONTH, (since[:, 1:] >= 0.0).astype(float)
        scale = np.repeat([RAMP, STEP], [ramps.shape[1], steps.shape[1]])
        both = np.concatenate([onsets, onsets[1:]])
        return cls(both, np.hstack([ramps, steps]), scale, apart / YEAR)

    @classmethod
    def steps(cls, days: Float[np.ndarray, " n"]) -> "Changes":
        """Steps at each recording, where they are large enough for a day to matter."""
        onsets = days[1:]
        columns = (days[:, None] >= onsets).astype(float)
        years = float(days[-1] - days[0]) / len(onsets) / YEAR
        return cls(onsets, columns, np.full(len(onsets), STEP), years)

    @property
    def is_ramp(self) -> np.ndarray:
        """Which are ramps."""
        return self.scale == RAMP


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of a series' regressors and scatter before it is looked at.

    Attributes:
        mean: of the coefficients b.
        precision: inverse of their covariance in units of σ².
        log_kinds: logarithm of the shares of kinds of scatter.
    """

    mean: Float[np.ndarray, "series regressors"]
    precision: Float[np.ndarray, "series regressors regressors"]
    log_kinds: Float[np.ndarray, "kinds series"]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What recordings say of changes.

    Attributes:
        log_none: evidence for no change with each kind of scatter, with the share of that kind.
        log_factor: of each change against none, up and down, prior shares included.
        size: expected size of each change before its sign is taken for known.
        deviation: of it.
        freedom: degrees of freedom of its distribution by Student.
        plain: coefficients b where nothing changes.
        per_size: by how much they are less for a change by 1.
        covariance: of b for a known change.
        sigma: σ where nothing changes.
        R: what the alarm goes by [years].
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
        """Share of each kind of scatter where nothing changes."""
        return np.exp(self.log_none - logsumexp(self.log_none, axis=0))

    @property
    def of_changes(self) -> Float[np.ndarray, "2 kinds series alternatives"]:
        """Share of each change, if there is one: together 1 a series."""
        log = self.log_factor + self.log_none[None, :, :, None]
        return np.exp(log - logsumexp(log, axis=(0, 1, 3), keepdims=True))


def evidence(sums: Sums, changes: Changes, prior: Prior) -> Evidence:
    """Evidence of all changes."""
    p, nu = prior.mean.shape[1], FREEDOM + sums.count - 1.0
    X = sums.base[..., :p, :p]
    A = X + prior.precision
    b, C = sums.base[..., :p, p], sums.cross[..., :p, :]
    toward = np.einsum("kspq,sq->ksp", X, prior.mean)
    yy = sums.base[..., p, p] - np.einsum("ksp,sp->ks", 2.0 * b - toward, prior.mean)
    inverse = np.linalg.inv(A)
    plain = np.einsum("kspq,ksq->ksp", inverse, b - toward)
    per_size = inverse @ C
    r = FREEDOM * SIZE**2 + yy - np.einsum("ksp,ksp->ks", b - toward, plain)
    a = sums.own - np.einsum("kspa,kspa->ksa", C, per_size)
    c = (
        sums.cross[..., p, :]
        - np.einsum("kspa,sp->ksa", C, prior.mean)
        - np.einsum("kspa,ksp->ksa", C, plain)
    )
    log_none = prior.log_kinds - 0.5 * (sums.log_det + np.linalg.slogdet(A)[1] + nu * np.log(r))
    known = np.maximum(a, 0.0) + changes.scale**-2.0
    left = np.maximum(r[..., None] - c**2 / known, 1e-12)
    gain = -0.5 * (np.log(known * changes.scale**2) + nu[:, None] * np.log(left / r[..., None]))
    size, deviation = c / known, np.sqrt(left / nu[:, None] / known)
    up = stdtr(nu[:, None], np.stack([size, -size]) / deviation)
    with np.errstate(divide="ignore"):
        ways = gain + np.log(2.0 * up)
    kinds = np.log([share for _, share in KINDS])
    ways = ways + np.where(changes.is_ramp, kinds[:2, None], kinds[2:, None])[:, None, None]
    log = ways + log_none[None, :, :, None]
    R = logsumexp(log, axis=(0, 1, 3)) - logsumexp(log_none, axis=0) + np.log(changes.years)
    return Evidence(
        log_none, ways, size, deviation, nu,
        plain + prior.mean, per_size,
        inverse * (r / nu)[..., None, None], np.sqrt(r / nu),
        np.exp(np.minimum(R, 600.0)),
    )  # fmt: skip
