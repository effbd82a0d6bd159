"""Spreads between robots by marginal likelihood, with their intervals."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from deltaid.population.coordinates import KINDS, VAGUE, Coordinates
from deltaid.population.mixed import Mean, Rows, mean, slope

# Spreads below and above these shares are not looked for.
_LEAST, _MOST = 1e-4, 2.0
# Step of log s for the curvature.
_STEP = 0.05
# Log likelihood that a spread of nearly zero must lose for the spread to be there (95 %).
_THERE = 1.92
# Sizes are not further off than by such a share.
_LIKELY_OFF = 0.5
# From so many robots on their spreads can be known.
ENOUGH = 3


@dataclass(frozen=True, eq=False)
class Spreads:
    """Standard deviations between robots, as shares of the sizes of entries.

    Attributes:
        kinds: what has one.
        log: logarithms of the most likely.
        covariance: of these logarithms.
        known: whether there are robots enough to know them.
        there: of which kinds the robots show that they differ at all.
    """

    kinds: tuple[str, ...]
    log: Float[np.ndarray, " kinds"]
    covariance: Float[np.ndarray, "kinds kinds"]
    known: bool
    there: np.ndarray

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a spread's square: its logarithm has the variance 1 / 2ν."""
        return float(0.5 / np.mean(np.diag(self.covariance)))

    def of_unknown_sizes(
        self, coordinates: Coordinates, covariance: Float[np.ndarray, "u u"]
    ) -> "Spreads":
        """With intervals that know that spreads are shares of sizes which are not known well.

        What is off of one size is off of a kind's spread by a part, as many as it has entries.

        Args:
            covariance: of the mean, in sizes.
        """
        at = coordinates.kind_of()
        off = np.minimum(np.diag(covariance), _LIKELY_OFF**2)
        more = [off[at == k].mean() / np.sum(at == k) for k in range(len(self.kinds))]
        return replace(self, covariance=self.covariance + np.diag(more))

    def variance(
        self, coordinates: Coordinates, log: np.ndarray | None = None
    ) -> Float[np.ndarray, " u"]:
        """S."""
        own = np.exp(2 * (self.log if log is None else log))
        at = coordinates.kind_of()
        return np.where(at >= 0, own[at], 0.0)


def prior_spreads(coordinates: Coordinates) -> Spreads:
    """What spreads are likely to be before any robot is seen."""
    kinds = coordinates.present
    log = np.log([KINDS[kind] for kind in kinds])
    n = len(kinds)
    return Spreads(kinds, log, VAGUE**2 * np.eye(n), False, np.zeros(n, dtype=bool))


def fitted_spreads(rows: Rows, coordinates: Coordinates, start: Spreads | None = None) -> Spreads:
    """The most likely spreads of the robots that count."""
    before = prior_spreads(coordinates)
    if rows.counts.sum() < ENOUGH:
        return before
    at, centre = coordinates.kind_of(), before.log

    def posterior(log: np.ndarray) -> tuple[float, np.ndarray, Mean]:
        found = mean(
            rows, before.variance(coordinates, log), coordinates.precision, coordinates.prior
        )
        away = (log - centre) / VAGUE
        gained = slope(rows, found, at) - away / VAGUE
        return found.evidence - 0.5 * float(away @ away), gained, found

    def falling(log: np.ndarray) -> tuple[float, np.ndarray]:
        value, gained, _ = posterior(log)
        return -value, -gained

    first = (start or before).log
    bounds = [(np.log(_LEAST), np.log(_MOST))] * len(first)
    done = minimize(falling, first, jac=True, method="L-BFGS-B", bounds=bounds,
                    options={"maxiter": 60, "ftol": 1e-9})  # fmt: skip
    log = np.asarray(done.x)
    top, _, _ = posterior(log)
    n, H, there = len(log), np.zeros((len(log), len(log))), np.zeros(len(log), dtype=bool)
    for k in range(n):
        step = _STEP * np.eye(n)[k]
        H[k] = (posterior(log - step)[1] - posterior(log + step)[1]) / (2 * _STEP)
        none = log.copy()
        none[k] = np.log(_LEAST)
        away = (
            0.5 * ((none[k] - centre[k]) / VAGUE) ** 2 - 0.5 * ((log[k] - centre[k]) / VAGUE) ** 2
        )
        there[k] = top - (posterior(none)[0] + away) > _THERE
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    values = np.maximum(values, VAGUE**-2)
    return Spreads(before.kinds, log, (vectors / values) @ vectors.T, True, there)
