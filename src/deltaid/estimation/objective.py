"""The objective (15) as a function of the free variables x, from the information alone; its solver
and solution."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.information import Information
from deltaid.estimation.reduction import Reduction
from deltaid.estimation.regularizer import Matrix, Quadratic, Regularizer, Vector


@dataclass(frozen=True)
class Objective:
    """J(x) = data term + γ_p · regulariser, eq. (15) with γ_τ = 1. Without unit."""

    reduction: Reduction  # what x means, and where it is consistent
    data: Quadratic  # γ_τ/s ‖τ̄ − Ȳ p‖²_W
    regularizer: Regularizer
    gamma: float  # γ_p

    def evaluate(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Value, gradient and Hessian with respect to x."""
        value, gradient, hessian = self.data.evaluate(x)
        v, g, H = self.regularizer.evaluate(x)
        return value + self.gamma * v, gradient + self.gamma * g, hessian + self.gamma * H

    def value(self, x: Vector) -> float:
        return self.evaluate(x)[0]


@dataclass(frozen=True)
class Solution:
    """A minimiser x of the objective and how good it is."""

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
            IdentificationError: the objective is not one for this solver, or it did not reach its
                end.
        """
        ...


def data_term(information: Information, reduction: Reduction) -> Quadratic:
    """The first term of (15), with W_τ = diag(τ_max)⁻² and γ_τ = 1."""
    at = information.columns
    rows = information.problem.substituted(reduction.A[at], reduction.p_0[at])
    return Quadratic.from_rows(
        np.column_stack([rows.A, rows.b]) / np.sqrt(information.mean_samples)
    )


def noise_level(information: Information) -> float:
    """σ̂ of the weighted torques, as a share of τ_max, whatever the parameters: the residual of the
    unconstrained least squares over all columns, with its degrees of freedom."""
    return information.of_drives.problem.noise


def default_gamma(information: Information, prior_spread: float) -> float:
    """γ_p by maximum a posteriori, γ_p/γ_τ = σ̂² / (s · spread²): minimising (15) with it maximises
    the posterior probability for torque noise of standard deviation σ̂ τ_max, estimated from the
    data, and a prior whose relative standard deviation is `prior_spread`."""
    sigma = max(noise_level(information), NOISE_FLOOR)
    return sigma**2 / (information.mean_samples * prior_spread**2)
