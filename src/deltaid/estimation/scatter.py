"""Variances of fitted parameters from the scatter between groups of samples.

Least squares has the error R⁻¹ s with s = Qᵀe, where Q R is the weighted base regressor and e the
noise. For white noise of level σ, a combination uᵀs has the variance σ²‖u‖². Torque noise is not
white: a filter and friction correlate it in time, drives differ, ripple repeats with the pose. So
samples belong to groups g, and the scatter of their contributions s_g = Q_gᵀ ê, by residuals ê, has
the noise's level and its correlation within groups:

    v(u) = ‖u‖² Σ_g (uᵀs_g)² / t(u),    t(u) = tr Ω(u),    ν(u) = (tr Ω)² / tr Ω²

Ω_gh = uᵀ(δ_gh H_g − H_g H_h)u with H_g = Q_gᵀQ_g; Ω σ² is the covariance of the uᵀs_g for white
noise, reduced by the fit. So v is unbiased for white noise, and by Satterthwaite's rule it is
distributed as σ²‖u‖² χ²_ν/ν: intervals use Student's t with ν degrees of freedom (Bell and
McCaffrey 2002; Imbens and Kolesár 2016).

Facts, whose noise is known, belong to no group: with H_0 = 1 − Σ_g H_g, they add σ̂² uᵀH_0 u, and
uᵀ(1 − H_0)u replaces ‖u‖² above.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular
from scipy.special import gammaincc, gammaln, ndtri, stdtrit

from deltaid.estimation.information import Chunk
from deltaid.levels import FAINT, NEGLIGIBLE, ROUNDING

# Degrees of freedom where only facts determine a combination.
_SURE = 1e9
# Significance level of a test: its probability of rejecting a true hypothesis.
CHANCE = 1e-3
# Half width of a 95 % interval in known standard deviations: `quantile` of ∞.
NORMAL = float(ndtri(0.975))
# Standard deviation of a normal distribution over its median magnitude.
ROBUST = 1.0 / ndtri(0.75)

# Columns of a chunk, and its product with itself at each place.
Visits = tuple[Int[np.ndarray, " _"], Float[np.ndarray, "places _ _"]]
Combinations = Float[np.ndarray, "n combinations"]
Each = Float[np.ndarray, " combinations"]
# [Y, τ]ᵀW[Y, τ] of each group.
Sums = Float[np.ndarray, "groups augmented augmented"]


class PlaceSums:
    """Running sums of [Y, τ]ᵀ[Y, τ] by place; `add` the `visits` of all samples, then read `sums`.

    An error that depends on the pose (torque ripple, a wrong length) repeats whenever the robot
    returns, so stretches of time agree although all are wrong. Groups by place keep such errors
    together.

    Places are parts of a box [m], given by its lowest and highest corner, along each axis. Finer
    places than thirds of the box separate errors that belong together; coarser ones are too few.
    """

    def __init__(
        self,
        box: Float[np.ndarray, "2 3"],
        drives: int,
        augmented: int,
        parts: tuple[int, int, int] = (3, 3, 3),
    ) -> None:
        self._low, self._parts = box[0], np.array(parts)
        self._size = np.maximum(box[1] - box[0], np.finfo(float).tiny)
        self._shape = int(np.prod(parts)), drives, augmented, augmented
        self._totals: list[Visits] = []

    def visits(self, r: Float[np.ndarray, "samples 3"], drives: Iterable[Chunk]) -> list[Visits]:
        """Some samples by place: the platform point r there, and each drive's rows of [Y, τ]."""
        parts = (r - self._low) / self._size * self._parts
        place = np.clip(parts, 0, self._parts - 1).astype(int) @ np.cumprod([1, *self._parts[:-1]])
        order, count = np.argsort(place, kind="stable"), self._shape[0]
        ends = np.searchsorted(place[order], np.arange(count + 1))
        visits = []
        for columns, samples in drives:
            products = np.zeros((count, len(columns), len(columns)))
            ordered = samples[:, order]
            for k in np.flatnonzero(np.diff(ends)):
                inside = ordered[:, ends[k] : ends[k + 1]]
                np.matmul(inside, inside.T, out=products[k])
            visits.append((columns, products))
        return visits

    def add(self, visits: list[Visits]) -> None:
        if not self._totals:
            self._totals = [(columns, np.zeros_like(products)) for columns, products in visits]
        for (_, total), (_, products) in zip(self._totals, visits, strict=True):
            total += products

    @property
    def sums(self) -> Float[np.ndarray, "places drives augmented augmented"]:
        """[Y_i, τ_i]ᵀ[Y_i, τ_i] of every place and drive i."""
        sums = np.zeros(self._shape)
        for i, (columns, total) in enumerate(self._totals):
            sums[:, i, columns[:, None], columns] = total
        return sums


@dataclass(frozen=True)
class Scatter:
    """Shares H_g, scores s_g and σ̂; the shares of groups and facts add up to 1."""

    shares: Float[np.ndarray, "groups n n"]
    scores: Float[np.ndarray, "groups n"]
    sigma: float = 0.0

    def variances(self, U: Combinations) -> tuple[Each, Each]:
        """v and ν of the columns of U; NaN where the groups do not determine them."""
        HU = np.moveaxis(self.shares @ U, 2, 0)  # combinations, groups, n
        own = np.einsum("cgn,nc->cg", HU, U)
        whole, size = np.sum(U**2, axis=0), own.sum(axis=1)
        by_facts = whole - size > NEGLIGIBLE * whole
        facts = self.sigma**2 * np.where(by_facts, whole - size, 0.0)
        size = np.where(by_facts, size, whole)
        omega = -HU @ np.swapaxes(HU, 1, 2)
        diagonal = np.arange(len(self.shares))
        omega[:, diagonal, diagonal] += own
        t = np.trace(omega, axis1=1, axis2=2)
        t = np.where(t > FAINT * size, t, np.nan)
        hardly = size <= FAINT * whole  # groups hardly contribute
        v = np.where(hardly, 0.0, size * np.sum((self.scores @ U) ** 2, axis=0) / t)
        nu = np.where(hardly, 1.0, np.maximum(t**2 / np.sum(omega**2, axis=(1, 2)), 1.0))
        if not facts.any():
            return v, nu
        return v + facts, nu * np.where(v > 0, (1.0 + facts / np.where(v > 0, v, 1.0)) ** 2, _SURE)


@dataclass(frozen=True)
class Noise:
    """The noise of a fit: its white level, and the scatter that is used instead, if any."""

    root: Float[np.ndarray, "n n"]  # R; errors of the fit are R⁻¹ s
    sigma: float  # level of the residual, for white noise
    freedom: float  # degrees of freedom of sigma
    scatter: Scatter | None = None  # between groups of samples; None without groups
    groups: str = "none"  # kind of the groups: 'time', 'place', or 'none'

    def deviations(self, U: Combinations) -> tuple[Each, Each]:
        """Standard deviations of uᵀs for the columns of U, and their degrees of freedom."""
        white = self.sigma * np.linalg.norm(U, axis=0)
        if self.scatter is None:
            return white, np.full(U.shape[1], self.freedom)
        v, nu = self.scatter.variances(U)
        valid = np.isfinite(v)
        return np.where(valid, np.sqrt(v), white), np.where(valid, nu, 1.0)


def half_width(std: Each, by_noise: Each, freedom: Each) -> Each:
    """Half the width of 95 % intervals, by Satterthwaite: only the part by noise is estimated."""
    smallest = np.maximum(FAINT * std, np.finfo(float).tiny)
    return quantile(freedom * (std / np.maximum(by_noise, smallest)) ** 4) * std


def observe(
    root: Float[np.ndarray, "n n"],
    values: Float[np.ndarray, " n"],
    sigma: float,
    freedom: float,
    groupings: Iterable[tuple[str, Sums]],
) -> Noise:
    """The noise behind a fit, by the grouping with the largest scatter.

    Groups that separate correlated errors scatter too little and, apart from chance, never too
    much. So of several groupings of the same samples, that with the largest mean logarithm of the
    variances of all values is used.
    """
    best, largest = Noise(root, sigma, freedom), -np.inf
    U = inverse(root).T
    for name, sums in groupings:
        half = U @ sums[:, :-1]  # R⁻ᵀ [Y_gᵀY_g, Y_gᵀτ_g]
        scatter = Scatter(half[:, :, :-1] @ U.T, half[:, :, -1] - half[:, :, :-1] @ values, sigma)
        v, _ = scatter.variances(U)
        valid = v > 0
        if not valid.any():
            continue
        size = float(np.mean(np.log(v[valid] / np.sum(U**2, axis=0)[valid])))
        if size > largest:
            best, largest = Noise(root, sigma, freedom, scatter, name), size
    return best


def surprise(x: float, freedom: int) -> float:
    """−log₁₀ of the probability that χ² exceeds x, also where that is too small for a number."""
    a, half = 0.5 * freedom, 0.5 * x
    tail = float(gammaincc(a, half))
    if tail > 1e-280:
        return -float(np.log10(tail)) if a > 0 else 0.0
    return float((half - (a - 1) * np.log(half) + gammaln(a)) / np.log(10))


def inverse(root: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """R⁻¹ of a triangular R."""
    return solve_triangular(root, np.eye(len(root)))


def correlations(V: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Correlations of a covariance, positive definite even if rounding has made it singular."""
    size = np.sqrt(np.diag(V))
    return V / np.outer(size, size) + ROUNDING * np.eye(len(V))


def scaled_cholesky(
    V: Float[np.ndarray, "n n"],
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    """L and d with V = diag(d) L Lᵀ diag(d), also if rounding has made V singular."""
    return np.linalg.cholesky(correlations(V)), np.sqrt(np.diag(V))


def quantile(nu: Each) -> Each:
    """Student's 97.5 % quantile: half width of a 95 % interval in standard deviations."""
    return stdtrit(nu, 0.975)
