"""The paper's route to a minimum of (15): without constraints, over π of the log-Cholesky map."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from deltaid.estimation.log_cholesky_map import LogCholeskyMap
from deltaid.estimation.objective import Objective
from deltaid.estimation.regularizer import Vector
from deltaid.estimation.solver import Solution


@dataclass(frozen=True)
class LogCholesky:
    """A minimum of J(π), eq. (15), by a trust-region Newton method with exact Hessians.

    Starts at the prior, π₀ = argmin ‖p(π) − p_reg‖ (Sec. VIII B), which the Cholesky factor gives
    exactly. On the way an exponential may run towards zero, where its gradient dies and the
    iteration with it; so the regulariser starts strong, where the minimum is near the prior, and is
    relaxed tenfold at a time to the γ asked for. The solution's bound is −∞: this route has no
    certificate of its own.

    Attributes:
        strong: γ where the relaxation starts.
        iterations, last_iterations: of Newton's method for each of its steps and for the last one.
        gradient: of J/γ, at which a step ends.
        visit: called with π after every iteration.
    """

    strong: float = 1e-2
    iterations: int = 15
    last_iterations: int = 500
    gradient: float = 1e-6
    visit: Callable[[Vector], None] = lambda _: None
    certifies: ClassVar[bool] = False

    def solve(self, objective: Objective) -> Solution:
        """A minimum near the path of relaxed regularisers.

        Raises:
            IdentificationError: the pattern of free entries has no Cholesky factor.
        """
        from scipy import optimize  # slow to load, and seldom needed

        chart = LogCholeskyMap(objective.reduction)
        pi, iterations, message = chart.pi(objective.reduction.prior), 0, ""
        for gamma in self._relaxation(objective.gamma):
            last = gamma == objective.gamma
            problem = Unconstrained(replace(objective, gamma=gamma), chart)
            result = optimize.minimize(
                problem.value,
                pi,
                method="trust-exact",
                jac=problem.gradient,
                hess=problem.hessian,
                callback=self.visit,
                options={
                    "gtol": self.gradient,
                    "maxiter": self.last_iterations if last else self.iterations,
                },
            )
            pi, iterations, message = result.x, iterations + int(result.nit), str(result.message)
        x = chart.x(pi)
        return Solution(x, objective.value(x), -np.inf, iterations, message.rstrip("."))

    def _relaxation(self, gamma: float) -> list[float]:
        """Tenfold steps from a strong regulariser down to γ."""
        steps = max(0, int(np.ceil(np.log10(self.strong / gamma))))
        return [gamma * 10.0**k for k in range(steps, -1, -1)]


class Unconstrained:
    """J(π)/γ with gradient and Hessian; keeps the last point, which all three share.

    Where an exponential overflows, J is infinite, so that every method shortens its step; a NaN
    compares as false and would be taken for a step down.
    """

    def __init__(self, objective: Objective, chart: LogCholeskyMap) -> None:
        self._objective, self._chart = objective, chart
        self._at: bytes = b""
        self._last: tuple[float, Vector, np.ndarray] = (np.nan, np.zeros(0), np.zeros((0, 0)))

    def value(self, pi: Vector) -> float:
        return self._evaluate(pi)[0]

    def gradient(self, pi: Vector) -> Vector:
        return self._evaluate(pi)[1]

    def hessian(self, pi: Vector) -> np.ndarray:
        return self._evaluate(pi)[2]

    def _evaluate(self, pi: Vector) -> tuple[float, Vector, np.ndarray]:
        if pi.tobytes() != self._at:
            scale = self._objective.gamma  # brings the regulariser to the order of one
            with np.errstate(over="ignore", invalid="ignore"):
                value, g, H = self._objective.evaluate(self._chart.x(pi))
                _, J, second = self._chart.derivatives(pi, g)
                value = value if np.isfinite(value) else np.inf
                self._last = (value / scale, J.T @ g / scale, (J.T @ H @ J + second) / scale)
            self._at = pi.tobytes()
        return self._last
