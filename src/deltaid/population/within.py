"""Every robot within its type, averaged over what is open of the spreads between them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.estimation.information import triangle
from deltaid.population.belonging import Sorted
from deltaid.population.coordinates import Coordinates
from deltaid.population.mixed import Rows, mean
from deltaid.population.spreads import Spreads

# Draws of the spreads, in pairs.
_DRAWS = 16
# Half the width of a normal 95 % interval in standard deviations.
NORMAL = 1.959964


def draws(spreads: Spreads) -> list[np.ndarray]:
    """Logarithms of spreads as likely as not, in pairs about the most likely."""
    z = np.random.default_rng(0).standard_normal((_DRAWS // 2, len(spreads.log)))
    away = z @ np.linalg.cholesky(spreads.covariance).T
    return [spreads.log + sign * one for one in away for sign in (1.0, -1.0)]


def std_of(T: np.ndarray, C: np.ndarray) -> Float[np.ndarray, " parameters"]:
    """Standard deviations of p for a covariance of u."""
    return np.sqrt(np.maximum(np.einsum("pu,uv,pv->p", T, C, T), 0.0))


def members_within(
    found: Sorted, coordinates: Coordinates, logs: Sequence[np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """u of every robot and its covariance, averaged over spreads.

    Given the mean u is normal about m + S AᵀL⁻¹(b − H m); see `mixed`.
    """
    size = coordinates.precision.shape[0]
    first, second = np.zeros((count, size)), np.zeros((count, size, size))
    for log in logs:
        s = found.spreads.variance(coordinates, log)
        one = mean(found.rows, s, coordinates.precision, coordinates.prior)
        m, covariance = one.m, one.covariance
        for at, part in found.rows.parts():
            own = s + part.extra
            A, c, _ = part.whitened(s)
            u = m + own * np.einsum("rnu,rn->ru", A, c - A @ m)
            SA = own[:, :, None] * np.swapaxes(A, 1, 2)
            B = np.eye(size) - SA @ A
            C = -SA @ np.swapaxes(SA, 1, 2) + B @ covariance @ np.swapaxes(B, 1, 2)
            C[:, np.arange(size), np.arange(size)] += own
            n = len(first[at])
            first[at] += u[:n]
            second[at] += (C + u[:, :, None] * u[:, None, :])[:n]
    first, second = first / len(logs), second / len(logs)
    return first, second - first[:, :, None] * first[:, None, :]


def alone(rows: Rows, coordinates: Coordinates) -> list[tuple[np.ndarray, np.ndarray]]:
    """u of each robot and its covariance by its own rows and the description."""
    n, root = len(coordinates.prior), np.linalg.cholesky(coordinates.precision).T
    known, found = np.column_stack([root, root @ coordinates.prior]), []
    for H, b in zip(rows.H, rows.b, strict=True):
        R = triangle(np.vstack([known, np.column_stack([H, b])]))
        inverse = solve_triangular(R[:n, :n], np.eye(n))
        found.append((inverse @ R[:n, n], inverse @ inverse.T))
    return found


def spread_between(
    T: np.ndarray, spreads: Spreads, coordinates: Coordinates
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each parameter between robots, with its interval; NaN where it cannot be known.

    The lower end is zero where robots do not show that they differ.
    """
    nothing = np.full(len(T), np.nan)
    if not spreads.known:
        return nothing, nothing, nothing
    at, s = coordinates.kind_of(), spreads.variance(coordinates)
    parts = np.stack([(T[:, at == k] ** 2) @ s[at == k] for k in range(len(spreads.kinds))], axis=1)
    total = parts.sum(axis=1)
    shares = parts / np.where(total > 0, total, 1.0)[:, None]
    deviation = np.sqrt(np.einsum("pk,kl,pl->p", shares, spreads.covariance, shares))
    spread = np.sqrt(total)
    low = spread * np.exp(-NORMAL * deviation) * (shares @ spreads.there > 0.5)
    return spread, low, spread * np.exp(NORMAL * deviation)
