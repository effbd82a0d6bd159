"""How unlikely something is by chance, in decades."""

import numpy as np
from scipy.special import gammaincc, gammaln


def surprise(x: float, freedom: int) -> float:
    """−log₁₀ of the probability that χ² exceeds x, also where that is too small for a number."""
    a, half = 0.5 * freedom, 0.5 * x
    tail = float(gammaincc(a, half))
    if tail > 1e-280:
        return -float(np.log10(tail)) if a > 0 else 0.0
    return float((half - (a - 1) * np.log(half) + gammaln(a)) / np.log(10))
