"""The nearest parameters that a robot can have, in the metric of what is known of them."""

import numpy as np
from jaxtyping import Float

from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.information import triangle
from deltaid.estimation.objective import DataTerm, Objective
from deltaid.estimation.regularizer import QuadraticTerm, Regularizer
from deltaid.population.coordinates import Coordinates

# Eigenvalues of a covariance below this share of the largest are rounding.
_ROUNDING = 1e-13


def consistent(
    coordinates: Coordinates, u: Float[np.ndarray, " u"], covariance: Float[np.ndarray, "u u"]
) -> Float[np.ndarray, " parameters"]:
    """p of u, or of the most likely u whose bodies can exist.

    Raises:
        IdentificationError: the solver did not reach its end.
    """
    reduction, n = coordinates.reduction, coordinates.size
    x = u[:n] * coordinates.sizes
    try:
        return reduction.parameters(x)
    except IdentificationError:
        return reduction.parameters(_nearest(coordinates, u[:n], covariance[:n, :n]))


def _nearest(
    coordinates: Coordinates, u: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, " n"]:
    """The conic program  min ‖W (x − x_u)‖²  over the cone, WᵀW the inverse covariance."""
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, _ROUNDING * values[-1])
    W = vectors.T / np.sqrt(values)[:, None] / coordinates.sizes
    R = triangle(W)
    x = u * coordinates.sizes
    none = QuadraticTerm(np.zeros((1, len(x))), coordinates.reduction.prior)
    objective = Objective(
        coordinates.reduction, DataTerm(R, R @ x, 0.0), Regularizer(none, None), 1.0
    )
    return Conic().solve(objective).x
