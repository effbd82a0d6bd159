"""The objective (15) as a function of the free variables x, posed from information and settings,
with the interfaces of solvers and solutions.

Its second term, the distance of x from the prior, has three metrics. All are without unit and agree
to second order: ε² for a parameter that changes by a small share ε. Derivatives are exact.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout, inertia_scale
from deltaid.errors import IdentificationError
from deltaid.estimation.information import Information, triangle
from deltaid.estimation.reduction import Block, Reduction
from deltaid.levels import FAINT
from deltaid.model.options import RegularizerName
from deltaid.model.record import Settings

Vector = Float[np.ndarray, " n"]
Matrix = Float[np.ndarray, "n n"]
Eigenvalues = Float[np.ndarray, "*batch k"]


@dataclass(frozen=True)
class Quadratic:
    """‖R x − b‖² + c: the data term, or the part of a regulariser that is quadratic in x."""

    R: Float[np.ndarray, "rows n"]
    b: Float[np.ndarray, " rows"]
    c: float = 0.0

    @classmethod
    def from_rows(cls, rows: Float[np.ndarray, "rows augmented"], c: float = 0.0) -> "Quadratic":
        """‖A x − b‖² + c of rows [A b], with a triangle R."""
        factor, n = triangle(rows), rows.shape[1] - 1
        R = np.zeros((n + 1, n + 1))
        R[: len(factor)] = factor
        return cls(R[:n, :n], R[:n, n], c + float(R[n, n] ** 2))

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Value, gradient and Hessian."""
        r = self.R @ x - self.b
        return float(r @ r) + self.c, 2 * self.R.T @ r, 2 * self.R.T @ self.R


@dataclass(frozen=True)
class Divergence:
    """A function Σ φ(λ_i) of eigenvalues, zero at 1 only, with φ′ and φ″."""

    convex: bool  # in the matrix with these eigenvalues
    values: Callable[[Eigenvalues], Eigenvalues]
    slope: Callable[[Eigenvalues], Eigenvalues]
    curvature: Callable[[Eigenvalues], Eigenvalues]


# The log-det Bregman divergence [35], twice.
LOG_DET = Divergence(
    convex=True,
    values=lambda lam: 2 * (lam - 1 - np.log(lam)),
    slope=lambda lam: 2 * (1 - 1 / lam),
    curvature=lambda lam: 2 / lam**2,
)
# The squared affine-invariant distance [36].
AFFINE_INVARIANT = Divergence(
    convex=False,
    values=lambda lam: np.log(lam) ** 2,
    slope=lambda lam: 2 * np.log(lam) / lam,
    curvature=lambda lam: 2 * (1 - np.log(lam)) / lam**2,
)


@dataclass(frozen=True)
class SpectralTerm:
    """A divergence of the eigenvalues of M_reg⁻¹ M(x), over all blocks with a weight each."""

    divergence: Divergence
    blocks: tuple[Block, ...]
    weights: tuple[float, ...]

    def values(self, x: Float[np.ndarray, "points n"]) -> Float[np.ndarray, " points"]:
        """Values alone, at many points inside the cone."""
        total = np.zeros(len(x))
        for block, weight in zip(self.blocks, self.weights, strict=True):
            lam = np.linalg.eigvalsh(block.normalised_at(x))
            total += weight * self.divergence.values(lam).sum(axis=1)
        return total

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Value, gradient and Hessian; infinite outside the cone.

        With A = L⁻¹ M L⁻ᵀ, M_reg = L Lᵀ and A = V diag(λ) Vᵀ, the gradient of Σ φ(λ) is
        V diag(φ′) Vᵀ, and its derivative along E is V (Γ ∘ VᵀEV) Vᵀ with the divided differences Γ
        of φ′ (Daleckii–Krein).
        """
        phi, value = self.divergence, 0.0
        gradient, hessian = np.zeros(len(x)), np.zeros((len(x), len(x)))
        for block, weight in zip(self.blocks, self.weights, strict=True):
            at, _, slopes = block.normalised
            lam, V = np.linalg.eigh(block.normalised_at(x))
            if lam[0] <= 0:
                return np.inf, np.full(len(x), np.nan), np.full(hessian.shape, np.nan)
            slope, curvature = phi.slope(lam), phi.curvature(lam)
            difference = np.subtract.outer(lam, lam)
            close = np.abs(difference) < 1e-7 * lam[-1]
            Gamma = np.where(
                close,
                0.5 * np.add.outer(curvature, curvature),
                np.subtract.outer(slope, slope) / np.where(close, 1.0, difference),
            )
            E = V.T @ slopes @ V
            value += weight * float(np.sum(phi.values(lam)))
            gradient[at] += weight * np.einsum("kii,i->k", E, slope)
            hessian[np.ix_(at, at)] += weight * np.einsum("kij,lij->kl", E * Gamma, E)
        return value, gradient, hessian


@dataclass(frozen=True)
class Regularizer:
    """A regulariser: a quadratic and, except for the paper's, a spectral term."""

    quadratic: Quadratic
    spectral: SpectralTerm | None

    @property
    def convex(self) -> bool:
        return self.spectral is None or self.spectral.divergence.convex

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        value, gradient, hessian = self.quadratic.evaluate(x)
        if self.spectral is None:
            return value, gradient, hessian
        v, g, H = self.spectral.evaluate(x)
        return value + v, gradient + g, hessian + H


def regularizer(reduction: Reduction, divergence: Divergence | None = None) -> Regularizer:
    """The distance of x from the prior.

    ‖p − p_reg‖² with W_p = diag(p_reg)⁻² as in (15), over all entries of p that x can change. An
    entry with p_reg = 0 has the scale m·ℓ (first moments) or m·ℓ² (products), where ℓ is the
    body's radius of gyration about the link frame, ℓ² = tr Σ / m.

    A divergence replaces this over the blocks that must be positive definite; first moments of a
    body whose mass is completed belong to no block. A block's prior is as wide as that of the
    widest entry of p that it affects.
    """
    D, weights = reduction.A.copy(), list[float]()
    for block in reduction.blocks if divergence else ():
        variables = block.index[block.index >= 0]
        D[:, variables] = 0.0
        parts = np.any(reduction.A[:, variables] != 0, axis=1)
        weights.append(float(reduction.wider[parts].max() ** -2))
    rows = np.any(D != 0, axis=1)
    D = D[rows] / prior_scale(reduction)[rows, None]
    spectral = divergence and SpectralTerm(divergence, reduction.blocks, tuple(weights))
    return Regularizer(Quadratic(D, D @ reduction.prior), spectral)


METRICS: dict[RegularizerName, Divergence | None] = {
    "euclidean": None,
    "entropic": LOG_DET,
    "riemannian": AFFINE_INVARIANT,
}


def prior_scale(reduction: Reduction) -> Float[np.ndarray, " parameters"]:
    """Scale of each entry of p (`parameter_scale`) times the factor of its prior's width."""
    return reduction.wider * parameter_scale(reduction.layout, reduction.p_reg)


def parameter_scale(
    layout: ParameterLayout, p_reg: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, " parameters"]:
    """|p_reg| or, for entries that are zero there, m·ℓ or m·ℓ² of the body, or their own scale."""
    scale = np.abs(p_reg)
    scale[list(layout.signed)] = list(layout.signed.values())
    for body in layout.bodies:
        part = layout.body(body)
        scale[part] = inertia_scale(p_reg[part])
    own = len(layout.names) - layout.added
    scale[own:] = [parameter.scale for parameter in layout.parameters[own:]]
    return scale


def prior_root(scaled: Matrix) -> Matrix:
    """R with RᵀR = the curvature of a prior, in units of the variables.

    Raises:
        IdentificationError: the prior's sizes differ too much for floating point.
    """
    try:
        return np.linalg.cholesky(scaled).T
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the prior's sizes differ too much to be weighed against each other",
            where="bodies",
            cure="check masses and lengths of the prior in the description",
        ) from None


@dataclass(frozen=True)
class Objective:
    """J(x) = data term + γ_p · regulariser, eq. (15) with γ_τ = 1. Without unit."""

    reduction: Reduction  # what x means, and where it is consistent
    data: Quadratic  # γ_τ/s ‖τ̄ − Ȳ p‖²_W
    regularizer: Regularizer
    gamma: float  # γ_p

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        value, gradient, hessian = self.data.evaluate(x)
        v, g, H = self.regularizer.evaluate(x)
        return value + self.gamma * v, gradient + self.gamma * g, hessian + self.gamma * H

    def value(self, x: Vector) -> float:
        return self.evaluate(x)[0]


@dataclass(frozen=True)
class Solution:
    """A minimiser x of the objective with its certificate."""

    x: Vector
    objective: float  # J(x)
    bound: float  # no consistent x has a smaller J; −∞ where nothing is known
    iterations: int  # of the solver, as its status
    status: str

    @property
    def duality_gap(self) -> float:
        """J(x) minus its lower bound, never negative."""
        return max(0.0, self.objective - self.bound)


@runtime_checkable
class Solver(Protocol):
    """A way to minimise J over all consistent x; a value that holds its tolerances."""

    certifies: ClassVar[bool]  # whether the bound proves how far a solution is from the optimum

    def solve(self, objective: Objective) -> Solution:
        """A minimiser of J.

        Raises:
            IdentificationError: the solver does not support this objective, or did not converge.
        """
        ...


def pose(information: Information, reduction: Reduction, settings: Settings) -> Objective:
    """Objective (15) for some information, with the settings' γ or that by maximum a posteriori."""
    return Objective(
        reduction,
        data_term(information, reduction),
        regularizer(reduction, METRICS[settings.regularizer]),
        settings.gamma or default_gamma(information, settings.prior_spread),
    )


def data_term(information: Information, reduction: Reduction) -> Quadratic:
    """The first term of (15), with W_τ = diag(τ_max)⁻² and γ_τ = 1."""
    at = information.columns
    problem = information.problem.substituted(reduction.A[at], reduction.p_0[at])
    rows = np.column_stack([problem.A, problem.b])
    return Quadratic.from_rows(rows / np.sqrt(information.mean_samples))


def noise_level(information: Information) -> float:
    """σ̂ of the weighted torques, as a share of τ_max: the residual of unconstrained least squares
    over all columns, by its degrees of freedom."""
    return information.of_drives.problem.noise


def default_gamma(information: Information, prior_spread: float) -> float:
    """γ_p by maximum a posteriori, γ_p/γ_τ = σ̂² / (s · spread²): minimising (15) with it maximises
    the posterior probability for torque noise of standard deviation σ̂ τ_max, estimated from the
    data, and a prior whose relative standard deviation is `prior_spread`."""
    sigma = max(noise_level(information), FAINT)
    return sigma**2 / (information.mean_samples * prior_spread**2)
