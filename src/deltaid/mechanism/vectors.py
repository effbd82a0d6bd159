"""Small vector algebra on CasADi SX."""

import casadi as ca
import numpy as np
from jaxtyping import Float


def fixed(A: Float[np.ndarray, "..."]) -> ca.SX:
    """Numbers without entries for what is zero but for rounding, so that no graph computes them."""
    A = np.asarray(A, dtype=float)
    return ca.SX(ca.sparsify(ca.DM(np.where(np.abs(A) < 1e-15, 0.0, A))))


def skew(v: ca.SX) -> ca.SX:
    """[v]ₓ without entries for the components of v that are zero by construction."""
    return ca.sparsify(ca.skew(v))


def reciprocal(x: ca.SX) -> ca.SX:
    """1 / x as x / x², because CasADi makes a division of every product with 1 / x; NaN at 0."""
    return x / (x * x)


def inverse(A: ca.SX) -> ca.SX:
    """Inverse of a small square matrix by cofactors; decoupled rows and columns cost nothing.

    Infinite where A is singular.
    """
    return ca.inv_minor(A)
