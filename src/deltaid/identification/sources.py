"""Where the noise of a fitted value comes from: torques, sensors beside them, or measured values.

Least squares errs by R⁻¹ s, s the sum of the scores of all rows (`scatter`). Rows a have the part
uᵀH_a u of ‖u‖² of a combination uᵀs, H_a = (A R⁻¹)ᵀ(A R⁻¹), which is their weight among all rows
in the combination too: of two sources that say the same, the one with half the standard deviation
has four fifths of it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import Information
from deltaid.estimation.scatter import Noise

Combinations = Float[np.ndarray, "n combinations"]


class Parts(NamedTuple):
    """Shares of the variance by noise, together one."""

    torques: Float[np.ndarray, " combinations"]
    sensors: Float[np.ndarray, " combinations"]
    measured: Float[np.ndarray, " combinations"]


@dataclass(frozen=True, eq=False)
class Sources:
    """The rows of a fit by where they come from, over R of its base parameters.

    Attributes:
        sensors, facts: A R⁻¹ of sensors, and of measured values.
        noise: of the fit.
    """

    sensors: Float[np.ndarray, "rows n"]
    facts: Float[np.ndarray, "facts n"]
    noise: Noise

    @classmethod
    def of(cls, information: Information, base: BaseParameters, noise: Noise) -> "Sources":
        """Of a fit's information."""
        at = np.searchsorted(information.columns, [one.representative for one in base.groups])
        own = slice(information.drives.stop, None)
        sensors = information.factors[own] * np.sqrt(information.weights[own])[:, None, None]
        facts = np.zeros((0, len(at))) if information.facts is None else information.facts[:, at]
        return cls(
            _over(sensors.reshape(-1, sensors.shape[2])[:, at], noise.root),
            _over(facts, noise.root),
            noise,
        )

    def parts(self, U: Combinations) -> Parts:
        """Of the columns of U; where there is nothing but torques, these are all."""
        n = U.shape[1]
        if not len(self.sensors) + len(self.facts):
            return Parts(np.ones(n), np.zeros(n), np.zeros(n))
        std, _ = self.noise.deviations(U)
        size = np.maximum(np.sum(U**2, axis=0), np.finfo(float).tiny)
        share = np.sum((self.facts @ U) ** 2, axis=0) / size
        known = share * size * self.noise.sigma**2
        variance = np.maximum(std**2, np.finfo(float).tiny)
        measured = np.clip(known / variance, 0.0, 1.0)
        rows = np.sum((self.sensors @ U) ** 2, axis=0) / size
        rest = np.maximum(1.0 - share, np.finfo(float).eps)
        sensors = (1.0 - measured) * np.clip(rows / rest, 0.0, 1.0)
        return Parts(1.0 - measured - sensors, sensors, measured)


def _over(
    rows: Float[np.ndarray, "rows n"], root: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "rows n"]:
    """Rows times R⁻¹."""
    return solve_triangular(root, rows.T, trans="T").T if len(rows) else rows
