"""Day-to-day scatter: a wander that forgets, and what is new every day.

What is left of a series y_t when all that explains it is taken out,

    u_t = w_t + e_t,   cov(w_s, w_t) = σ² ρ exp(−|t − s| / T),   var(e_t) = σ² (1 − ρ) v_t,

is told by the memory T, the share ρ of the wander, and σ. A Kalman filter takes out of every
column what the past foretells; what it leaves is white, and sums of its products are all that a
fit of any combination of columns needs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Memories [days] and shares of the wander that are tried, beside none at all, with how usual each
# is before any recording: long memories and wanders that are most of the scatter are rare.
MEMORIES = {2.0: 1.0, 5.0: 1.0, 12.0: 0.15, 30.0: 0.03}
SHARES = {0.15: 1.0, 0.35: 0.6, 0.6: 0.3, 0.85: 0.1}
_NONE = 2.0
# Rows whose products are taken at once.
_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class Scatter:
    """Kinds of scatter: memory T [days], share ρ, and how usual each is, together 1."""

    memory: Float[np.ndarray, " kinds"]
    share: Float[np.ndarray, " kinds"]
    usual: Float[np.ndarray, " kinds"]

    @classmethod
    def grid(cls) -> "Scatter":
        """None without memory, and all of the grid."""
        each = [(T, share, a * b) for T, a in MEMORIES.items() for share, b in SHARES.items()]
        memory, share, usual = np.array([(1.0, 0.0, _NONE), *each]).T
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
    scatter: Scatter,
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
    P = np.broadcast_to(share, (kinds, series)).copy()
    log_det = np.zeros((kinds, series))
    # What the past foretells of base and alternatives, and white rows of these.
    x, h = (np.zeros((kinds, series, m)) for m in (width, count))
    X, H = (np.zeros((kinds, series, _AT_ONCE, m)) for m in (width, count))
    squares, cross = (np.zeros((kinds, series, width, m)) for m in (width, count))
    own = np.zeros_like(h)
    for t in range(n):
        a = forget[:, t, None]
        if t:
            P = a**2 * P + share * (1.0 - a**2)
            x *= a[..., None]
            h *= a[..., None]
        S = P + (1.0 - share) * np.where(known[:, t], variance[:, t], 1.0)
        gain, weight = np.where(known[:, t], P / S, 0.0), known[:, t] / np.sqrt(S)
        new_x, new_h, k = base[:, t] - x, alternatives[t] - h, t % _AT_ONCE
        X[:, :, k], H[:, :, k] = weight[..., None] * new_x, weight[..., None] * new_h
        log_det += np.where(known[:, t], np.log(S), 0.0)
        x += gain[..., None] * new_x
        h += gain[..., None] * new_h
        P = P * (1.0 - gain)
        if k == _AT_ONCE - 1 or t == n - 1:
            some, others = X[:, :, : k + 1], H[:, :, : k + 1]
            squares += some.swapaxes(2, 3) @ some
            cross += some.swapaxes(2, 3) @ others
            own += np.einsum("ksta,ksta->ksa", others, others)
    return Sums(squares, cross, own, log_det, known.sum(axis=1).astype(float))
