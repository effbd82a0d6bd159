"""How far identified parameters can be trusted, given data and prior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.information import triangle
from deltaid.estimation.regularizer import prior_scale
from deltaid.estimation.scatter import half_width
from deltaid.identification.fit import FittedProblem
from deltaid.identification.sources import Sources

# Others whose priors a parameter rests on are named until they make up this share of what priors
# leave open, so many at most.
_TOLD, _MOST = 0.7, 2


@dataclass(frozen=True)
class Uncertainty:
    """How far the parameters p of a fit can be trusted, given data and prior.

    Attributes:
        std, interval: standard deviation, and half the width of the 95 % interval.
        prior_std: standard deviation given the prior alone, widened where it is.
        shares: of the variance: by noise of torques, of sensors and of measured values, by the
            prior, and by geometry.
        moves: column i is by how many standard deviations of its own prior each parameter moves
            along what priors leave open of parameter i.
        follows: how far each parameter goes with least-squares base parameters.
    """

    std: Float[np.ndarray, " parameters"]
    interval: Float[np.ndarray, " parameters"]
    prior_std: Float[np.ndarray, " parameters"]
    shares: Float[np.ndarray, "parameters 5"]
    moves: Float[np.ndarray, "others parameters"]
    follows: Float[np.ndarray, "base parameters"]

    def rests_on(self, i: int, among: Bool[np.ndarray, " parameters"]) -> tuple[int, ...]:
        """Other parameters whose priors make up most of what priors leave open of parameter i.

        The variance by the prior, cᵀ H⁻¹ P H⁻¹ c, is a sum over the parameters: the squares of
        `moves`.

        Args:
            among: which may be named.
        """
        share = np.where(among, self.moves[:, i] ** 2, 0.0)
        share[i] = 0.0
        order = np.argsort(-share, kind="stable")[:_MOST]
        before = np.append(0.0, np.cumsum(share[order])[:-1])
        return tuple(int(k) for k in order[(before < _TOLD * share.sum()) & (share[order] > 0)])


def uncertainty(
    problem: FittedProblem, combinations: Float[np.ndarray, "n parameters"] | None = None
) -> Uncertainty:
    """Deviations of the minimiser of (15) from the truth, by noise, by the prior and by geometry.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²). With its Hessian
    H = D + P, D from the data and P from the prior, x errs by H⁻¹ (g + P (x_prior − x)), where g is
    what the noise adds to the gradient. The variance by the prior is cᵀ H⁻¹ P H⁻¹ c for a
    combination cᵀx; that by the noise comes from the scatter of the recording (`scatter`), and for
    white noise would be cᵀ H⁻¹ D H⁻¹ c. Where a body touches the edge of consistency this reaches
    beyond it. Geometry that is off shifts least squares by δp_B, and x by H⁻¹ D δp_B.

    A sharp sum of two parameters does not make the two known: each keeps the part by the prior of
    the other, and is as good as that (`consistent_range` does without).

    Args:
        combinations: of parameters, in whose place results are; each parameter alone if None.

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
    wanted = A if combinations is None else combinations @ A
    factor = triangle(np.vstack([data, root]))
    H_inverse_A = solve_triangular(factor, solve_triangular(factor, wanted.T, trans="T"))
    prior_share = unit**2 * np.sum((root @ H_inverse_A) ** 2, axis=0)
    in_scores = noise.root @ (problem.base.combination() @ (A @ H_inverse_A))
    to_scores = 2.0 / (objective.gamma * samples) * in_scores
    by_noise, freedom = noise.deviations(to_scores)
    geometry = problem.geometry
    shifts = geometry.shifts if geometry else np.zeros((problem.base.rank, 0))
    follows = noise.root.T @ to_scores
    by_geometry = np.sum((follows.T @ shifts) ** 2, axis=1)
    sources = Sources.of(problem.information, problem.base, noise).parts(to_scores)
    of_noise = [by_noise**2 * part for part in sources]
    parts = np.stack([*of_noise, prior_share, by_geometry], axis=1)
    variance = parts.sum(axis=1)
    std, half = np.sqrt(variance), half_width(np.sqrt(variance), by_noise, freedom)
    prior_std = unit * np.linalg.norm(solve_triangular(root, wanted.T, trans="T"), axis=0)
    moves = A @ H_inverse_A / prior_scale(reduction)[:, None]
    shares = parts / np.where(variance > 0, variance, 1.0)[:, None]
    return Uncertainty(std, half, prior_std, shares, moves, follows)
