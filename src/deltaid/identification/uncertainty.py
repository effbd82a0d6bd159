"""How far identified parameters can be trusted, given data and prior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.identification.fit import FittedProblem
from deltaid.identification.information import triangle
from deltaid.identification.objective import NOISE_FLOOR
from deltaid.identification.scatter import quantile

# The data decided a parameter whose standard deviation it shrank below this share of the prior's.
_SHRUNK = 0.5
# Noise that is so many times smaller than the standard deviation does not matter.
_HARDLY = 100.0


@dataclass(frozen=True)
class Uncertainty:
    """How far the parameters p of a fit can be trusted, given data and prior.

    Attributes:
        std, interval: standard deviation, and half the width of the 95 % interval.
        prior_std: standard deviation given the prior alone.
        by_data: whether the data decided.
    """

    std: Float[np.ndarray, " parameters"]
    interval: Float[np.ndarray, " parameters"]
    prior_std: Float[np.ndarray, " parameters"]
    by_data: Bool[np.ndarray, " parameters"]


def uncertainty(problem: FittedProblem) -> Uncertainty:
    """Deviations of the minimiser of (15) from the truth, by noise and by the prior.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²). With its Hessian
    H = D + P, D from the data and P from the prior, x errs by H⁻¹ (g + P (x_prior − x)), where g is
    what the noise adds to the gradient. The variance by the prior is cᵀ H⁻¹ P H⁻¹ c for a
    combination cᵀx; that by the noise comes from the scatter of the recording (`scatter`), and for
    white noise would be cᵀ H⁻¹ D H⁻¹ c. Where a body touches the edge of consistency this reaches
    beyond it.

    Data decides where the standard deviation is less than half of the prior's. A sharp sum of two
    parameters does not make the two known: each keeps the part by the prior of the other.

    Raises:
        IdentificationError: the prior's sizes are too far apart for the arithmetic.
    """
    objective, reduction, noise = problem.objective, problem.reduction, problem.estimate.noise
    samples, sigma = problem.information.mean_samples, max(problem.noise, NOISE_FLOOR)
    unit = sigma * np.sqrt(2.0 / (samples * objective.gamma))
    _, _, hessian = objective.regularizer.evaluate(reduction.prior)
    scale = np.sqrt(np.diag(hessian))
    try:
        root = np.linalg.cholesky(hessian / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the prior's sizes differ too much to be weighed against each other",
            where="bodies",
            cure="check masses and lengths of the prior in the description",
        ) from None
    data = np.sqrt(2.0 / objective.gamma) * objective.data.R / scale
    A = reduction.A / scale
    factor = triangle(np.vstack([data, root]))
    H_inverse_A = solve_triangular(factor, solve_triangular(factor, A.T, trans="T"))
    prior_share = unit**2 * np.sum((root @ H_inverse_A) ** 2, axis=0)
    in_scores = noise.root @ (problem.base.combination() @ (A @ H_inverse_A))
    by_noise, freedom = noise.deviations(2.0 / (objective.gamma * samples) * in_scores)
    std = np.hypot(by_noise, np.sqrt(prior_share))
    # Satterthwaite: only the part by noise is estimated.
    least = np.maximum(std / _HARDLY, np.finfo(float).tiny)
    nu = freedom * (std / np.maximum(by_noise, least)) ** 4
    prior_std = unit * np.linalg.norm(solve_triangular(root, A.T, trans="T"), axis=0)
    return Uncertainty(std, quantile(nu) * std, prior_std, std < _SHRUNK * prior_std)
