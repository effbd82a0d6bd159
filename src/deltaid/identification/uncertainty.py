"""Uncertainty of identified parameters and its sources, given data and prior (`uncertainty`) or
data and physical consistency alone (`ConsistentRanges`)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.objective import Vector, prior_root, prior_scale
from deltaid.estimation.ranges import ACCURACY, ConsistentBall
from deltaid.estimation.scatter import Combinations, Each, Noise, half_width, inverse, quantile
from deltaid.identification.fit import FittedProblem
from deltaid.levels import FAINT
from deltaid.model.parameter_record import Share

# Share of the variance by priors that named other parameters must make up, two of them at most.
_NAMED = 0.7
# Share of t at which noise and geometry are negligible.
_VANISHED = 1e-2

Coefficients = Float[np.ndarray, " parameters"]


class Sources:
    """Shares of torques, sensors and measured values in the noise of a fitted value.

    Least squares has the error R⁻¹ s with the sum s of the scores of all rows (`scatter`). Rows A
    have the part uᵀHu of ‖u‖² in a combination uᵀs, H = (A R⁻¹)ᵀ(A R⁻¹). This is also their weight:
    of two equal sources, the one with half the standard deviation has four fifths.
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
    """Uncertainty of the parameters p of a fit, given data and prior.

    Attributes:
        std, interval: standard deviation, and half the width of the 95 % interval.
        prior_std: standard deviation given the prior alone, as widened.
        shares: of the variance: by noise of torques, of sensors and of measured values, by the
            prior, and by geometry.
        moves: column i has the part of each parameter's prior in the deviation of parameter i.
        follows: slopes of the parameters by least-squares base parameters.
    """

    std: Float[np.ndarray, " parameters"]
    interval: Float[np.ndarray, " parameters"]
    prior_std: Float[np.ndarray, " parameters"]
    shares: Float[np.ndarray, "parameters 5"]
    moves: Float[np.ndarray, "others parameters"]
    follows: Float[np.ndarray, "base parameters"]

    def leading_priors(self, i: int, among: Bool[np.ndarray, " parameters"]) -> tuple[int, ...]:
        """Other parameters, out of `among`, whose priors make up most of the variance by priors of
        parameter i, cᵀ H⁻¹ P H⁻¹ c: the sum of the squares of `moves`."""
        share = np.where(among, self.moves[:, i] ** 2, 0.0)
        share[i] = 0.0
        order = np.argsort(-share, kind="stable")[:2]
        before = np.append(0.0, np.cumsum(share[order])[:-1])
        return tuple(order[(before < _NAMED * share.sum()) & (share[order] > 0)].tolist())


def uncertainty(
    problem: FittedProblem, combinations: Float[np.ndarray, "n parameters"] | None = None
) -> Uncertainty:
    """Deviations of the minimiser of (15) from the truth, by noise, prior and geometry, for
    combinations of parameters or each parameter.

    Minimising J maximises a posterior whose negative logarithm is s J / (2 σ̂²), with the Hessian
    H = D + P by data and prior. The error of x is H⁻¹ (g + P (x_prior − x)), with the noise g of
    the gradient. For a combination cᵀx, the variance by the prior is cᵀ H⁻¹ P H⁻¹ c; that by noise
    comes from the scatter of the recording (`scatter`), and for white noise is cᵀ H⁻¹ D H⁻¹ c.
    Geometric errors shift least squares by δp_B, and x by H⁻¹ D δp_B. Physical consistency is
    ignored: a deviation may exceed it.

    Two parameters with a well-known sum depend on each other's priors; `ConsistentRanges` does
    without priors. Errors as of `prior_root`.
    """
    objective, reduction, noise = problem.objective, problem.reduction, problem.estimate.noise
    samples, sigma = problem.information.mean_samples, max(problem.noise, FAINT)
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
    parts.append(np.sum((follows.T @ problem.geometry.shifts) ** 2, axis=1))
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


def covariance(problem: FittedProblem, places: Sequence[int]) -> Float[np.ndarray, "n n"]:
    """Covariance of some parameters given data and prior, from the variances of their sums:
    C_ij = (var(x_i + x_j) − var x_i − var x_j) / 2. Scatter gives each variance by itself, so C is
    approximate."""
    each = np.eye(len(problem.values))[list(places)]
    sums = (each[:, None] + each[None]).reshape(-1, each.shape[1])
    variances = uncertainty(problem, sums).std.reshape(len(each), -1) ** 2
    single = np.diag(variances) / 4  # var 2 x_i
    C = (variances - single[:, None] - single) / 2
    np.fill_diagonal(C, single)
    return C


class ConsistentRanges:
    """Ranges of parameters in a fit by the recording and physical consistency alone, without prior.

    The range of c·p is its least and largest value over all consistent x, p = A x + p_0, in a
    `ConsistentBall` of the data, in units of this combination's noise by the scatter of the
    recording (`scatter`), with Student's quantile t. Where the recording determines c·p, this is
    the 95 % interval of least squares; where it determines only a sum, priors of the other terms
    have no part in the range.

    Of the squared width, the part that remains with negligible noise and geometry is what the
    recording does not determine; these share the rest by their variances.
    """

    def __init__(self, problem: FittedProblem) -> None:
        data, base, information = problem.objective.data, problem.base, problem.information
        self._reduction, self._noise = problem.reduction, problem.estimate.noise
        self._sources = Sources(information, base, self._noise)
        self._white = max(self._noise.sigma, FAINT)
        rows = np.sqrt(information.mean_samples) / self._white
        blocks, scale = self._reduction.blocks, self._reduction.scale
        self._ball = ball = ConsistentBall(rows * data.R, rows * data.b, blocks, scale)
        combination = base.combination() @ self._reduction.A
        self._scores = self._noise.root @ combination @ ball.map[:, : ball.rank]
        self._shifts = self._noise.root @ problem.geometry.shifts

    def ends(self, c: Coefficients) -> tuple[float, float]:
        """Least and largest c·p; infinite where neither recording nor consistency bounds it."""
        c_x = self._reduction.A.T @ c
        low, high = self._ball.ends(c_x, self._reach(c_x)[0]) + c @ self._reduction.p_0
        more = ACCURACY * max(high - low, 0.0) if np.isfinite(high - low) else 0.0
        return float(low - more), float(high + more)

    def share(self, c: Coefficients, low: float, high: float) -> Share:
        """Shares of the sources of the range of c·p, which must be finite."""
        c_x = self._reduction.A.T @ c
        t, by_noise = self._reach(c_x)
        width = (high - low) / (1.0 + 2.0 * ACCURACY)
        ratio = float(np.ptp(self._ball.ends(c_x, _VANISHED * t))) / width if width > 0 else 0.0
        unseen = float(np.clip((ratio**2 - _VANISHED**2) / (1 - _VANISHED**2), 0.0, 1.0))
        parts = np.array(self._sources.parts(self._in_scores(c_x)))[:, 0]
        noise, sensors, measured = ((1 - unseen) * by_noise * parts).tolist()
        return Share(
            noise=noise,
            prior=0.0,
            geometry=(1 - unseen) * (1 - by_noise),
            unseen=unseen,
            sensors=sensors,
            measured=measured,
        )

    def _in_scores(self, c_x: Vector) -> Float[np.ndarray, "base 1"]:
        return (self._scores @ (self._ball.map.T @ c_x)[: self._ball.rank])[:, None]

    def _reach(self, c_x: Vector) -> tuple[float, float]:
        """t with scatter and geometry, in units of white noise, and the share of noise in the
        variance."""
        U = self._in_scores(c_x)
        size = float(np.linalg.norm(U))
        if size == 0:
            return float(quantile(np.array([self._noise.freedom]))[0]), 1.0
        by_noise, nu = self._noise.deviations(U)
        std = np.hypot(by_noise, np.linalg.norm(U.T @ self._shifts))
        t = half_width(std, by_noise, nu)[0] / (self._white * size)
        return float(t), float((by_noise[0] / std[0]) ** 2) if std[0] > 0 else 1.0
