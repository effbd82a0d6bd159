"""How much a motion tells about the base parameters, from its information matrix G = mean Y_BᵀWY_B.

Columns are scaled beforehand, so G has no units. Each criterion is a function of the eigenvalues of
G, smaller is better, with the gradient ∂J/∂G = V diag(φ′) Vᵀ.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.motion.excitation.options import CriterionName

# A direction that a motion does not excite at all has eigenvalue zero; the logarithm then stops
# here instead of at minus infinity.
_SMALLEST = 1e-14


@dataclass(frozen=True)
class Criterion:
    """A criterion by name.

    cond:      log λ_max − log λ_min, that is log cond(Y_BᵀWY_B).
    logdet:    −(1/n) Σ log λ_i, D-optimality per parameter.
    a-optimal: log((1/n) Σ 1/λ_i), the mean variance.
    e-optimal: −log λ_min, the largest variance.
    """

    name: CriterionName

    def evaluate(self, G: Float[np.ndarray, "n n"]) -> tuple[float, Float[np.ndarray, "n n"]]:
        """Value and gradient ∂J/∂G."""
        lam, V = np.linalg.eigh(G)
        lam = np.maximum(lam, _SMALLEST)
        slope, n = np.zeros_like(lam), len(lam)
        match self.name:
            case "cond":
                value = np.log(lam[-1] / lam[0])
                slope[-1], slope[0] = 1 / lam[-1], -1 / lam[0]
            case "logdet":
                value, slope = -np.mean(np.log(lam)), -1 / (n * lam)
            case "a-optimal":
                total = np.sum(1 / lam)
                value, slope = np.log(total / n), -1 / (lam**2 * total)
            case "e-optimal":
                value = -np.log(lam[0])
                slope[0] = -1 / lam[0]
        return float(value), (V * slope) @ V.T
