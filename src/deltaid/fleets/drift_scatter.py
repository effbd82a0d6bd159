"""Scatter of friction from day to day: AR(1) noise plus white noise, and columns made white by it.

The residual of y_t after all regressors,

    u_t = w_t + e_t,   cov(w_s, w_t) = σ² ρ exp(−|t − s| / T),   var(e_t) = σ² (1 − ρ) v_t,

has the memory T, the share ρ of AR(1) noise, and σ. A Kalman filter subtracts its prediction from
every column; the innovations are white, and sums of their products are all that a fit of any
combination of columns needs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Candidate memories [days] and shares of AR(1) noise with prior weights: long memories and large
# shares are rare. A share of zero has the weight of a small one.
_MEMORIES = {2.0: 1.0, 5.0: 1.0, 12.0: 0.15, 30.0: 0.03}
_SHARES = {0.15: 1.0, 0.35: 0.6, 0.6: 0.3, 0.85: 0.1}
# Rows multiplied at once.
_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class DailyScatter:
    """Kinds of scatter: memory T [days], share ρ, and prior probability."""

    memory: Float[np.ndarray, " kinds"]
    share: Float[np.ndarray, " kinds"]
    usual: Float[np.ndarray, " kinds"]


# White noise, and all of the grid.
_KINDS = np.array(
    [
        (1.0, 0.0, sum(_MEMORIES.values())),
        *((T, share, a * b) for T, a in _MEMORIES.items() for share, b in _SHARES.items()),
    ]
)
USUAL_SCATTER = DailyScatter(_KINDS[:, 0], _KINDS[:, 1], _KINDS[:, 2] / _KINDS[:, 2].sum())


@dataclass(frozen=True, eq=False)
class WhiteSums:
    """Products of white columns, for every kind of scatter and every series.

    Attributes:
        products: of regressors and the series with these, then with alternatives.
        squares: of each alternative with itself.
        log_det: logarithm of the determinant of the scatter's covariance for σ = 1.
        count: recordings of each series.
    """

    products: Float[np.ndarray, "kinds series base columns"]
    squares: Float[np.ndarray, "kinds series alternatives"]
    log_det: Float[np.ndarray, "kinds series"]
    count: Float[np.ndarray, " series"]


def whitened_sums(
    days: Float[np.ndarray, " n"],
    variance: Float[np.ndarray, "series n"],
    base: Float[np.ndarray, "series n base"],
    alternatives: Float[np.ndarray, "n alternatives"],
    scatter: DailyScatter,
) -> WhiteSums:
    """Sums over time of products of white columns.

    Args:
        days: of recordings, ascending [days].
        variance: v_t; infinite where a series has no recording.
        base: regressors, the series last; finite everywhere.
        alternatives: columns of possible changes.
    """
    kinds, (series, n, width) = len(scatter.share), base.shape
    share, memory = scatter.share[:, None], scatter.memory[:, None]
    forget = np.exp(-np.diff(days, prepend=days[:1]) / memory)
    known, count = np.isfinite(variance), alternatives.shape[1]
    columns = np.concatenate([base, np.broadcast_to(alternatives, (series, n, count))], axis=2)
    P = np.broadcast_to(share, (kinds, series)).copy()
    predicted, white = (np.zeros((kinds, series, *m, width + count)) for m in ((), (_AT_ONCE,)))
    products = np.zeros((kinds, series, width, width + count))
    squares, log_det = np.zeros((kinds, series, count)), np.zeros((kinds, series))
    for t in range(n):
        a = forget[:, t, None]
        if t:
            P = a**2 * P + share * (1.0 - a**2)
            predicted *= a[..., None]
        S = P + (1.0 - share) * np.where(known[:, t], variance[:, t], 1.0)
        gain, weight = np.where(known[:, t], P / S, 0.0), known[:, t] / np.sqrt(S)
        new, k = columns[:, t] - predicted, t % _AT_ONCE
        white[:, :, k] = weight[..., None] * new
        log_det += np.where(known[:, t], np.log(S), 0.0)
        predicted += gain[..., None] * new
        P = P * (1.0 - gain)
        if k == _AT_ONCE - 1 or t == n - 1:
            some = white[:, :, : k + 1]
            products += some[..., :width].swapaxes(2, 3) @ some
            squares += np.einsum("ksta,ksta->ksa", some[..., width:], some[..., width:])
    return WhiteSums(products, squares, log_det, known.sum(axis=1).astype(float))
