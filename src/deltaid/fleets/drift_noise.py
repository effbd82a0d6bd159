"""Day-to-day scatter: AR(1) noise plus white noise.

The residual of a series y_t after all regressors,

    u_t = w_t + e_t,   cov(w_s, w_t) = σ² ρ exp(−|t − s| / T),   var(e_t) = σ² (1 − ρ) v_t,

has the memory T, the share ρ of AR(1) noise, and σ. A Kalman filter subtracts its prediction from
every column; the innovations are white, and sums of their products are all that a fit of any
combination of columns needs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Candidate memories [days] and shares of AR(1) noise, in addition to none, with prior weights: long
# memories and large shares are rare.
MEMORIES = {2.0: 1.0, 5.0: 1.0, 12.0: 0.15, 30.0: 0.03}
SHARES = {0.15: 1.0, 0.35: 0.6, 0.6: 0.3, 0.85: 0.1}
# Prior weight of no memory at all beside these.
_NONE = 2.0
# Rows whose products are taken at once.
_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class DailyScatter:
    """Kinds of scatter: memory T [days], share ρ, and how usual each is, together 1."""

    memory: Float[np.ndarray, " kinds"]
    share: Float[np.ndarray, " kinds"]
    usual: Float[np.ndarray, " kinds"]

    @classmethod
    def grid(cls) -> "DailyScatter":
        """None without memory, and all of the grid."""
        kinds = [(T, share, a * b) for T, a in MEMORIES.items() for share, b in SHARES.items()]
        memory, share, usual = np.array([(1.0, 0.0, _NONE), *kinds]).T
        return cls(memory, share, usual / usual.sum())


@dataclass(frozen=True, eq=False)
class Sums:
    """Products of white columns, for every kind of scatter and every series.

    Attributes:
        base: of the columns that always explain, the series itself last.
        cross: of these with alternatives.
        own: of each alternative with itself.
        log_det: logarithm of the determinant of the scatter's covariance for σ = 1.
        count: recordings of each series.
    """

    base: Float[np.ndarray, "kinds series base base"]
    cross: Float[np.ndarray, "kinds series base alternatives"]
    own: Float[np.ndarray, "kinds series alternatives"]
    log_det: Float[np.ndarray, "kinds series"]
    count: Float[np.ndarray, " series"]


def whitened_sums(
    days: Float[np.ndarray, " n"],
    variance: Float[np.ndarray, "series n"],
    base: Float[np.ndarray, "series n base"],
    alternatives: Float[np.ndarray, "n alternatives"],
    scatter: DailyScatter,
) -> Sums:
    """Sums over time of products of white columns.

    Args:
        days: when, ascending [days].
        variance: v_t; infinite where a series has no recording.
        base: columns that always explain, the series itself last; finite everywhere.
        alternatives: columns of which one explains a change.
    """
    kinds, (series, n, width) = len(scatter.share), base.shape
    share, memory = scatter.share[:, None], scatter.memory[:, None]
    forget = np.exp(-np.diff(days, prepend=days[:1]) / memory)
    known, count = np.isfinite(variance), alternatives.shape[1]
    columns = np.concatenate([base, np.broadcast_to(alternatives, (series, n, count))], axis=2)
    P = np.broadcast_to(share, (kinds, series)).copy()
    foretold, white = (np.zeros((kinds, series, *m, width + count)) for m in ((), (_AT_ONCE,)))
    products = np.zeros((kinds, series, width, width + count))
    squares, log_det = np.zeros((kinds, series, count)), np.zeros((kinds, series))
    for t in range(n):
        a = forget[:, t, None]
        if t:
            P = a**2 * P + share * (1.0 - a**2)
            foretold *= a[..., None]
        S = P + (1.0 - share) * np.where(known[:, t], variance[:, t], 1.0)
        gain, weight = np.where(known[:, t], P / S, 0.0), known[:, t] / np.sqrt(S)
        new, k = columns[:, t] - foretold, t % _AT_ONCE
        white[:, :, k] = weight[..., None] * new
        log_det += np.where(known[:, t], np.log(S), 0.0)
        foretold += gain[..., None] * new
        P = P * (1.0 - gain)
        if k == _AT_ONCE - 1 or t == n - 1:
            some = white[:, :, : k + 1]
            products += some[..., :width].swapaxes(2, 3) @ some
            squares += np.einsum("ksta,ksta->ksa", some[..., width:], some[..., width:])
    recordings = known.sum(axis=1).astype(float)
    return Sums(products[..., :width], products[..., width:], squares, log_det, recordings)
