"""Minimisers of J(π): runs of the paper's one and of three others.

J(π) of (15) has no bad local minimum, but where an exponential e^d tends to zero its gradient
vanishes, and the iteration stalls. The paper starts at π(p_reg) directly with the small γ
(Sec. VIII B) and does not name its solver, so three common ones start there: Newton with a trust
region and exact Hessians, Levenberg–Marquardt on the residuals, and BFGS, which approximates the
Hessian from gradients. The fourth relaxes the regulariser, like `estimation.log_cholesky`. The
conic program gives the minimum of J.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy import optimize

from deltaid.estimation.conic import Conic
from deltaid.estimation.log_cholesky import LogCholesky, LogCholeskyMap, Unconstrained
from deltaid.estimation.objective import Objective, Solution, Vector
from deltaid.estimation.reduction import Reduction
from deltaid.reproduce.accuracy import Accuracy

Way = Literal["newton", "levenberg-marquardt", "bfgs", "relaxed"]
WAYS: tuple[Way, ...] = ("newton", "levenberg-marquardt", "bfgs", "relaxed")
# Default gradient tolerance of common optimisation libraries, for the largest entry of ∇J.
USUAL_TOLERANCE = 1e-6
_Visit = Callable[[Vector], None]


@dataclass(frozen=True)
class Descent:
    """A run of one minimiser, one entry per step.

    Attributes:
        way: the method.
        seconds: since its start.
        objective: J.
        gradient: largest entry of |∇J| with respect to π.
        usual: the first step at which the gradient is below the usual tolerance; None if never.
        at_usual, at_end: accuracy of the parameters at that step and at the last one.
        smallest: the smallest exponential at the last step, relative to its value at the prior.
        smallest_name: its name.
        distance: of the last step from the global optimum, √Σ((x − x*)/scale)².
    """

    way: Way
    seconds: Float[np.ndarray, " steps"]
    objective: Float[np.ndarray, " steps"]
    gradient: Float[np.ndarray, " steps"]
    usual: int | None
    at_usual: Accuracy | None
    at_end: Accuracy
    smallest: float
    smallest_name: str
    distance: float


@dataclass(frozen=True)
class Descents:
    """Runs of all minimisers on one objective, with the global optimum and its certificate."""

    gamma: float
    conic: Solution
    conic_seconds: float
    ways: tuple[Descent, ...]


def descend(
    objective: Objective,
    judge: Callable[[Vector], Accuracy],
    iterations: int = 1000,
) -> Descents:
    """Run all minimisers on one objective with the paper's regulariser.

    Args:
        judge: accuracy of free variables x.
        iterations: largest number of steps of each method.

    Raises:
        IdentificationError: the conic program did not converge.
    """
    began = time.perf_counter()
    best = Conic().solve(objective)
    seconds = time.perf_counter() - began
    chart = LogCholeskyMap(objective.reduction)
    chart.x(chart.pi(objective.reduction.prior))  # builds the map in advance, at no method's cost
    ways = tuple(_watched(way, objective, chart, best, judge, iterations) for way in WAYS)
    return Descents(objective.gamma, best, seconds, ways)


def _watched(
    way: Way,
    objective: Objective,
    chart: LogCholeskyMap,
    best: Solution,
    judge: Callable[[Vector], Accuracy],
    iterations: int,
) -> Descent:
    path, stamps = [chart.pi(chart.reduction.prior)], [0.0]
    began = time.perf_counter()

    def visit(pi: Vector) -> None:
        stamps.append(time.perf_counter() - began)
        path.append(np.array(pi))

    with np.errstate(over="ignore", invalid="ignore"):  # by rejected steps
        _run(way, objective, chart, iterations, visit)
    problem = Unconstrained(objective, chart)
    gamma, reduction = objective.gamma, chart.reduction
    gradient = np.array([gamma * np.abs(problem.gradient(pi)).max() for pi in path])
    below = np.flatnonzero(gradient < USUAL_TOLERANCE)
    usual = int(below[0]) if below.size else None
    end = chart.x(path[-1])
    name, smallest = _smallest(reduction, path[-1] - path[0])
    return Descent(
        way=way,
        seconds=np.array(stamps),
        objective=np.array([gamma * problem.value(pi) for pi in path]),
        gradient=gradient,
        usual=usual,
        at_usual=None if usual is None else judge(chart.x(path[usual])),
        at_end=judge(end),
        smallest=smallest,
        smallest_name=name,
        distance=float(np.linalg.norm((end - best.x) / reduction.scale)),
    )


def _run(
    way: Way, objective: Objective, chart: LogCholeskyMap, iterations: int, visit: _Visit
) -> None:
    problem, start = Unconstrained(objective, chart), chart.pi(chart.reduction.prior)
    if way == "relaxed":
        LogCholesky(visit=visit).solve(objective)
    elif way == "levenberg-marquardt":
        _levenberg_marquardt(objective, chart, iterations, visit)
    else:
        newton = way == "newton"
        optimize.minimize(
            problem.value,
            start,
            method="trust-exact" if newton else "BFGS",
            jac=problem.gradient,
            hess=problem.hessian if newton else None,
            callback=visit,
            options={"gtol": 1e-6, "maxiter": iterations},
        )


def _levenberg_marquardt(
    objective: Objective, chart: LogCholeskyMap, iterations: int, visit: _Visit
) -> None:
    """Minimise J/γ as a sum of squares, ‖L x(π) − l‖² plus a constant."""
    data, prior, weight = objective.data, objective.regularizer.quadratic, objective.gamma**-0.5
    L = np.vstack([weight * data.R, prior.R])
    l = np.append(weight * data.b, prior.b)
    still = np.zeros(chart.reduction.size)

    def slopes(pi: Vector) -> np.ndarray:
        visit(pi)  # once per accepted step: rejected ones need residuals only
        return L @ chart.derivatives(pi, still)[1]

    optimize.least_squares(
        lambda pi: L @ chart.x(pi) - l,
        chart.pi(chart.reduction.prior),
        jac=slopes,
        method="lm",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=iterations,
    )


def _smallest(reduction: Reduction, change: Vector) -> tuple[str, float]:
    exponents = [k for k, variable in enumerate(reduction.variables) if not variable.signed]
    k = min(exponents, key=lambda k: change[k])
    return reduction.names[k], float(np.exp(change[k]))
