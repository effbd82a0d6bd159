"""The objective (15) as a function of the free variables x, from the information alone."""

from dataclasses import dataclass

import numpy as np

from deltaid.estimation.information import Information, triangle
from deltaid.estimation.reduction import Reduction
from deltaid.estimation.regularizer import Matrix, Regularizer, Vector
from deltaid.estimation.span import Span


@dataclass(frozen=True)
class DataTerm:
    """γ_τ/s ‖τ̄ − Ȳ p‖²_W = ‖R x − b‖² + c, with γ_τ/s inside R, b and c."""

    R: Matrix
    b: Vector
    c: float

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Value, gradient and Hessian."""
        r = self.R @ x - self.b
        return float(r @ r) + self.c, 2 * self.R.T @ r, 2 * self.R.T @ self.R


@dataclass(frozen=True)
class Objective:
    """J(x) = data term + γ_p · regulariser, eq. (15) with γ_τ = 1. Without unit.

    Attributes:
        reduction: what x means, and where it is consistent.
        data, regularizer: the two terms.
        gamma: γ_p.
    """

    reduction: Reduction
    data: DataTerm
    regularizer: Regularizer
    gamma: float

    @property
    def convex(self) -> bool:
        """Whether J is convex in x, so that a certificate of its optimum exists."""
        return self.regularizer.convex

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Value, gradient and Hessian with respect to x."""
        value, gradient, hessian = self.data.evaluate(x)
        v, g, H = self.regularizer.evaluate(x)
        return value + self.gamma * v, gradient + self.gamma * g, hessian + self.gamma * H

    def value(self, x: Vector) -> float:
        """J(x)."""
        return self.evaluate(x)[0]


def data_term(information: Information, reduction: Reduction) -> DataTerm:
    """The first term of (15), with W_τ = diag(τ_max)⁻² and γ_τ = 1."""
    factor = information.weighted()
    Y, tau = factor[:, :-1], factor[:, -1]
    at = information.columns
    reduced = np.column_stack([Y @ reduction.A[at], tau - Y @ reduction.p_0[at]])
    n = reduction.size
    padded = np.vstack([reduced, np.zeros((max(0, n + 1 - len(reduced)), n + 1))])
    R = triangle(padded) / np.sqrt(information.mean_samples)
    return DataTerm(R[:n, :n], R[:n, n], float(R[n, n] ** 2))


def noise_level(information: Information) -> float:
    """σ̂ of the weighted torques, as a share of τ_max: what no parameters whatever could explain.

    The residual of the unconstrained least squares over all columns, with its degrees of freedom.
    """
    drives = information.of_drives
    factor = drives.weighted()
    span = Span.of(factor[:, :-1])
    residual = span.without(factor[:, -1])
    return float(np.linalg.norm(residual) / np.sqrt(max(drives.rows - span.rank, 1)))


# Torques are never taken to be known better than this share of the largest one.
NOISE_FLOOR = 1e-6


def default_gamma(information: Information, prior_spread: float) -> float:
    """γ_p by maximum a posteriori: γ_p/γ_τ = σ̂² / (s · spread²).

    Minimising (15) with it is maximising the posterior probability for torque noise of standard
    deviation σ̂ τ_max, estimated from the data, and a prior whose relative standard deviation is
    `prior_spread`.
    """
    sigma = max(noise_level(information), NOISE_FLOOR)
    return sigma**2 / (information.mean_samples * prior_spread**2)
