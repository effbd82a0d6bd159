"""Widths of independent priors that claim no more than is known.

What is known of some variables is a precision Q, whose entries hang together: a sum may be known
far better than its terms. Priors of single entries r_jᵀx, of standard deviations 1/√w_j, are a
precision Σ_j w_j r_j r_jᵀ. If each of them were as narrow as Q's own entry, a sum that robots tell
would count again with every robot that tells it. So the narrowest are taken whose precision is no
more than Q in any direction: the w of the largest Σ log w_j with Q − Σ_j w_j r_j r_jᵀ ⪰ 0, by a
barrier and Newton's steps.
"""

import numpy as np
from jaxtyping import Float

# Weights of the barrier, one after the other; steps at each, and when they have settled.
_BARRIER, _STEPS, _SETTLED = np.geomspace(1.0, 1e-4, 9), 60, 1e-9
_ROUNDING = 1e-12


def widest(
    Q: Float[np.ndarray, "n n"], rows: Float[np.ndarray, "entries n"]
) -> Float[np.ndarray, " entries"]:
    """w of every entry."""
    size = np.sqrt(np.diag(Q))
    Q, rows = Q / np.outer(size, size), rows / size
    least = float(np.linalg.eigvalsh(Q)[0])
    Q = Q + max(_ROUNDING - least, 0.0) * np.eye(len(Q))
    L = np.linalg.cholesky(Q)
    of_rows = np.linalg.solve(L, rows.T)  # in which Q is 1
    log = np.log(0.5 / np.linalg.eigvalsh(of_rows @ of_rows.T)[-1]) * np.ones(len(rows))
    for t in _BARRIER:
        for _ in range(_STEPS):
            step = _newton(of_rows, log, float(t))
            log, before = _inside(of_rows, log, step, float(t)), log
            if np.max(np.abs(log - before)) < _SETTLED:
                break
    return np.exp(log)


def _left(of_rows: np.ndarray, log: np.ndarray) -> np.ndarray:
    return np.eye(len(of_rows)) - (of_rows * np.exp(log)) @ of_rows.T


def _newton(of_rows: np.ndarray, log: np.ndarray, t: float) -> Float[np.ndarray, " entries"]:
    """A step of log w upwards: Σ log w + t log det(1 − Σ w r rᵀ)."""
    w = np.exp(log)
    G = of_rows.T @ np.linalg.solve(_left(of_rows, log), of_rows)
    slope = 1.0 - t * w * np.diag(G)
    curved = t * (np.diag(w * np.diag(G)) + np.outer(w, w) * G**2)
    return np.linalg.solve(curved + 1e-9 * np.eye(len(w)), slope)


def _inside(
    of_rows: np.ndarray, log: np.ndarray, step: np.ndarray, t: float
) -> Float[np.ndarray, " entries"]:
    """A share of the step that stays inside and gains."""
    now, share = _value(of_rows, log, t), min(1.0, 3.0 / max(float(np.abs(step).max()), 1e-12))
    for _ in range(40):
        found = log + share * step
        if _value(of_rows, found, t) > now:
            return found
        share *= 0.5
    return log


def _value(of_rows: np.ndarray, log: np.ndarray, t: float) -> float:
    sign, size = np.linalg.slogdet(_left(of_rows, log))
    values = np.linalg.eigvalsh(_left(of_rows, log))
    return float(log.sum() + t * size) if sign > 0 and values[0] > 0 else -np.inf
