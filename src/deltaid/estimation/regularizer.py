"""How far x is from the prior: the second term of (15), in three metrics.

All are without unit and agree to second order for a parameter that changes by a small share ε of
itself: ε². Gradients and Hessians are exact.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout, inertia_scale
from deltaid.errors import IdentificationError
from deltaid.estimation.information import triangle
from deltaid.estimation.reduction import Block, Reduction

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
    """A function Σ φ(λ_i) of eigenvalues, zero at 1 only, with φ′ and φ″; `convex` says whether it
    is so in the matrix that has these eigenvalues."""

    convex: bool
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
        phi, value, gradient, hessian = (
            self.divergence,
            0.0,
            np.zeros(len(x)),
            np.zeros((len(x),) * 2),
        )
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
        """Value, gradient and Hessian."""
        value, gradient, hessian = self.quadratic.evaluate(x)
        if self.spectral is None:
            return value, gradient, hessian
        v, g, H = self.spectral.evaluate(x)
        return value + v, gradient + g, hessian + H


@dataclass(frozen=True)
class Metric:
    """What distance to the prior is measured with.

    ‖p − p_reg‖² with W_p = diag(p_reg)⁻² as in (15), over all entries of p that x can change. An
    entry with p_reg = 0 has the scale m·ℓ (first moments) or m·ℓ² (products), where ℓ is the
    body's radius of gyration about the link frame, ℓ² = tr Σ / m.

    With a divergence, this in place of it over the blocks that must be positive definite; first
    moments of a body whose mass is completed stand in no block. A block's prior is as wide as that
    of the widest entry of p that it is part of.
    """

    divergence: Divergence | None = None

    def regularizer(self, reduction: Reduction) -> Regularizer:
        D, weights = reduction.A.copy(), list[float]()
        for block in reduction.blocks if self.divergence else ():
            variables = block.index[block.index >= 0]
            D[:, variables] = 0.0
            parts = np.any(reduction.A[:, variables] != 0, axis=1)
            weights.append(float(reduction.wider[parts].max() ** -2))
        rows = np.any(D != 0, axis=1)
        D = D[rows] / prior_scale(reduction)[rows, None]
        quadratic = Quadratic(D, D @ reduction.prior)
        if self.divergence is None:
            return Regularizer(quadratic, None)
        spectral = SpectralTerm(self.divergence, reduction.blocks, tuple(weights))
        return Regularizer(quadratic, spectral)


def prior_scale(reduction: Reduction) -> Float[np.ndarray, " parameters"]:
    """|p_reg|, and for entries that are zero there m·ℓ or m·ℓ² of their body, or their own size;
    so many times that as the prior is widened."""
    return reduction.wider * parameter_scale(reduction.layout, reduction.p_reg)


def parameter_scale(
    layout: ParameterLayout, p_reg: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, " parameters"]:
    """The same for any prior."""
    scale = np.abs(p_reg)
    for i, size in layout.signed.items():
        scale[i] = size
    for body in layout.bodies:
        part = layout.body(body)
        scale[part] = inertia_scale(p_reg[part])
    own = len(layout.names) - layout.added
    scale[own:] = [parameter.scale for parameter in layout.parameters[own:]]
    return scale


def prior_root(scaled: Matrix) -> Matrix:
    """R with RᵀR = the curvature of a prior, in units of the variables; an IdentificationError
    where the prior's sizes are too far apart for the arithmetic."""
    try:
        return np.linalg.cholesky(scaled).T
    except np.linalg.LinAlgError:
        raise IdentificationError(
            "the prior's sizes differ too much to be weighed against each other",
            where="bodies",
            cure="check masses and lengths of the prior in the description",
        ) from None
