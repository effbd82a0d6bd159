"""Spreads between robots by marginal likelihood, with their intervals."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from deltaid.fleets.coordinates import KINDS, VAGUE, Coordinates
from deltaid.fleets.mixed_model import Mean, RobotRows, Square, U, mean, slope

# Bounds of the search for spreads, as shares.
_LEAST, _MOST = 1e-4, 2.0
# Step of log s for the curvature.
_STEP = 0.05
# Log likelihood that a spread of nearly zero must lose for the spread to be there (95 %).
_THERE = 1.92
# Sizes are not further off than by such a share.
_LIKELY_OFF = 0.5
# From so many robots on their spreads can be known.
ENOUGH = 3
# Draws of the spreads, in pairs.
_DRAWS = 16
# Half the width of a normal 95 % interval in standard deviations.
NORMAL = 1.959964


@dataclass(frozen=True, eq=False)
class Spreads:
    """Standard deviations between robots, as shares of the sizes of entries.

    Attributes:
        kinds: what has one.
        at: place of the kind of each of u; −1 of what has none.
        log: logarithms of the most likely.
        covariance: of these logarithms.
        known: whether there are robots enough to know them.
        there: of which kinds the robots show that they differ at all.
    """

    kinds: tuple[str, ...]
    at: Int[np.ndarray, " u"]
    log: Float[np.ndarray, " kinds"]
    covariance: Float[np.ndarray, "kinds kinds"]
    known: bool
    there: np.ndarray

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a spread's square: its logarithm has the variance 1 / 2ν."""
        return float(0.5 / np.mean(np.diag(self.covariance)))

    def variance(self, log: np.ndarray | None = None) -> U:
        """Variances S of the type."""
        variances = np.exp(2 * (self.log if log is None else log))
        return np.where(self.at >= 0, variances[self.at], 0.0)

    def draws(self) -> list[Float[np.ndarray, " kinds"]]:
        """Logarithms of spreads as likely as not, in pairs about the most likely."""
        z = np.random.default_rng(0).standard_normal((_DRAWS // 2, len(self.log)))
        away = z @ np.linalg.cholesky(self.covariance).T
        return [self.log + sign * step for step in away for sign in (1.0, -1.0)]

    def of_unknown_sizes(self, covariance: Square) -> "Spreads":
        """With the uncertainty of the sizes that spreads are shares of, whose covariance is given.

        An error of one size enters a kind's spread divided by its number of entries.
        """
        off = np.minimum(np.diag(covariance), _LIKELY_OFF**2)
        parts = [off[self.at == k] for k in range(len(self.kinds))]
        added = np.diag([part.mean() / len(part) for part in parts])
        return replace(self, covariance=self.covariance + added)

    def of_parameters(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Spread of each of T u between robots, with its interval; NaN where it cannot be known.

        The lower end is zero where robots do not show that they differ.
        """
        nothing = np.full(len(T), np.nan)
        if not self.known:
            return nothing, nothing, nothing
        members = self.at[:, None] == np.arange(len(self.kinds))
        parts = T**2 @ (members * self.variance()[:, None])
        total = parts.sum(axis=1)
        shares = parts / np.where(total > 0, total, 1.0)[:, None]
        deviation = np.sqrt(np.einsum("pk,kl,pl->p", shares, self.covariance, shares))
        spread = np.sqrt(total)
        low = spread * np.exp(-NORMAL * deviation) * (shares @ self.there > 0.5)
        return spread, low, spread * np.exp(NORMAL * deviation)


def prior_spreads(coordinates: Coordinates) -> Spreads:
    """Prior of the spreads."""
    kinds, at = coordinates.present, coordinates.kind_of()
    log, n = np.log([KINDS[kind] for kind in kinds]), len(kinds)
    return Spreads(kinds, at, log, VAGUE**2 * np.eye(n), False, np.zeros(n, dtype=bool))


def fitted_spreads(
    rows: RobotRows, coordinates: Coordinates, start: Spreads | None = None
) -> Spreads:
    """The most likely spreads of the robots that count."""
    before = prior_spreads(coordinates)
    if rows.counts.sum() < ENOUGH:
        return before

    def type_mean(log: np.ndarray) -> Mean:
        return mean(rows, before.variance(log), coordinates.precision, coordinates.prior)

    def falling(log: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the posterior, and its slope."""
        fitted, away = type_mean(log), (log - before.log) / VAGUE
        gained = slope(rows, fitted, before.at) - away / VAGUE
        return 0.5 * float(away @ away) - fitted.evidence, -gained

    first = (start or before).log
    bounds = [(np.log(_LEAST), np.log(_MOST))] * len(first)
    done = minimize(falling, first, jac=True, method="L-BFGS-B", bounds=bounds,
                    options={"maxiter": 60, "ftol": 1e-9})  # fmt: skip
    log = np.asarray(done.x)
    steps, top = np.eye(len(log)), type_mean(log).evidence
    H = np.array([falling(log + _STEP * e)[1] - falling(log - _STEP * e)[1] for e in steps])
    none = [np.where(e > 0, np.log(_LEAST), log) for e in steps]
    there = np.array([top - type_mean(without).evidence > _THERE for without in none])
    values, vectors = np.linalg.eigh((H + H.T) / (4 * _STEP))
    values = np.maximum(values, VAGUE**-2)
    covariance = (vectors / values) @ vectors.T
    return replace(before, log=log, covariance=covariance, known=True, there=there)
