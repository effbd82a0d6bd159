"""Hotelling's T² of estimates whose covariance comes from the scatter between stretches."""

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from deltaid.estimation.drive_rows import STRETCHES


def limit(free: int, rejected: float) -> float:
    """What T² with so many directions exceeds by chance in this share of cases."""
    nu = STRETCHES - 1
    return free * nu / (nu - free + 1) * float(fdtri(free, nu - free + 1, 1 - rejected))


def exceeded(
    values: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"], rejected: float
) -> bool:
    """Whether zero is rejected for estimates, wrongly in this share of cases."""
    scale = np.sqrt(np.diag(covariance))
    if not np.all(scale > 0):
        return False
    root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    white = np.linalg.solve(root, values / scale)
    return float(white @ white) > limit(len(values), rejected)
