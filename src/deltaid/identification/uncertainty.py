"""How far identified parameters can be trusted, given data and prior, and what that comes from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.regularizer import prior_root, prior_scale
from deltaid.estimation.scatter import Combinations, Each, Noise, half_width, inverse
from deltaid.identification.fit import FittedProblem

# Others whose priors a parameter rests on are named until they make up this share of what priors
# leave open, so many at most.
_NAMED, _MOST = 0.7, 2


class Sources:
    """Where the noise of a fitted value comes from: torques, sensors, or measured values.

    Least squares errs by R⁻¹ s, s the sum of the scores of all rows (`scatter`). Rows a have the
    part uᵀH_a u of ‖u‖² of a combination uᵀs, H_a = (A R⁻¹)ᵀ(A R⁻¹), which is their weight among
    all rows in the combination too: of two equal sources, the one with half the standard deviation
    has four fifths of it.
    """

    def __init__(self, information: Information, base: BaseParameters, noise: Noise) -> None:
        k = np.searchsorted(information.columns, base.representatives)
        part, over = slice(information.drives.stop, None), inverse(noise.root)
        sensors = information.factors[part] * np.sqrt(information.weights[part])[:, None, None]
        facts = np.zeros((0, len(k))) if information.facts is None else information.facts[:, k]
        self._sensors = sensors.reshape(-1, sensors.shape[2])[:, k] @ over
        self._facts, self._noise = facts @ over, noise

    def parts(self, U: Combinations) -> tuple[Each, Each, Each]:
        """Shares of torques, sensors and measured values in the variances of the columns of U."""
        size = np.maximum(np.sum(U**2, axis=0), np.finfo(float).tiny)
        variance = np.maximum(self._noise.deviations(U)[0] ** 2, np.finfo(float).tiny)
        known = np.sum((self._facts @ U) ** 2, axis=0)
        measured = np.clip(known * self._noise.sigma**2 / variance, 0.0, 1.0)
        rest = np.maximum(1.0 - known / size, np.finfo(float).eps)
        rows = np.sum((self._sensors @ U) ** 2, axis=0) / size
        sensors = (1.0 - measured) * np.clip(rows / rest, 0.0, 1.0)
        return 1.0 - measured - sensors, sensors, measured


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
        """Other parameters, of some, whose priors make up most of what priors leave open of i.

        The variance by the prior, cᵀ H⁻¹ P H⁻¹ c, is a sum over the parameters: the squares of
        `moves`.
        """
        share = np.where(among, self.moves[:, i] ** 2, 0.0)
        share[i] = 0.0
        order = np.argsort(-share, kind="stable")[:_MOST]
        before = np.append(0.0, np.cumsum(share[order])[:-1])
        return tuple(order[(before < _NAMED * share.sum()) & (share[order] > 0)].tolist())


def uncertainty(
    problem: FittedProblem, combinations: Float[np.ndarray, "n parameters"] | None = None
) -> Uncertainty:
    """Deviations of the minimiser of (15) from the truth, by noise, by the prior and by geometry;
    of combinations of parameters, or of each alone.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²). With its Hessian
    H = D + P, D from the data and P from the prior, x errs by H⁻¹ (g + P (x_prior − x)), where g is
    what the noise adds to the gradient. The variance by the prior is cᵀ H⁻¹ P H⁻¹ c for a
    combination cᵀx; that by the noise comes from the scatter of the recording (`scatter`), and for
    white noise would be cᵀ H⁻¹ D H⁻¹ c. Where a body touches the edge of consistency this reaches
    beyond it. Geometry that is off shifts least squares by δp_B, and x by H⁻¹ D δp_B.

    A sharp sum of two parameters does not make the two known: each keeps the part by the prior of
    the other, and is as good as that (`consistent_range` does without). Errors as of `prior_root`.
    """
    objective, reduction, noise = problem.objective, problem.reduction, problem.estimate.noise
    samples, sigma = problem.information.mean_samples, max(problem.noise, NOISE_FLOOR)
    unit = sigma * np.sqrt(2.0 / (samples * objective.gamma))
    _, _, hessian = objective.regularizer.evaluate(reduction.prior)
    scale = np.sqrt(np.diag(hessian))
    root = prior_root(hessian / np.outer(scale, scale))
    data = np.sqrt(2.0 / objective.gamma) * objective.data.R / scale
    A = reduction.A / scale
    combined = A if combinations is None else combinations @ A
    factor = triangle(np.vstack([data, root]))
    H_inverse_A = solve_triangular(factor, solve_triangular(factor, combined.T, trans="T"))
    in_scores = noise.root @ (problem.base.combination() @ (A @ H_inverse_A))
    to_scores = 2.0 / (objective.gamma * samples) * in_scores
    by_noise, freedom = noise.deviations(to_scores)
    follows = noise.root.T @ to_scores
    sources = Sources(problem.information, problem.base, noise).parts(to_scores)
    parts = [by_noise**2 * part for part in sources]
    parts.append(unit**2 * np.sum((root @ H_inverse_A) ** 2, axis=0))
    parts.append(np.sum((follows.T @ problem.shifts) ** 2, axis=1))
    variance = np.sum(parts, axis=0)
    std = np.sqrt(variance)
    return Uncertainty(
        std,
        half_width(std, by_noise, freedom),
        unit * np.linalg.norm(solve_triangular(root, combined.T, trans="T"), axis=0),
        np.stack(parts, axis=1) / np.where(variance > 0, variance, 1.0)[:, None],
        A @ H_inverse_A / prior_scale(reduction)[:, None],
        follows,
    )
