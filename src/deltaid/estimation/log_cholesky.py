"""The paper's route to a minimum of (15): without constraints, over π of the log-Cholesky map.

x(π) is consistent for every π (Sec. V). For each body M̄ = e^{2α} UᵀU with U upper triangular, its
diagonal (e^{d₁}, e^{d₂}, e^{d₃}, 1), products s and last column t, eqs. (12)–(14); friction and
rotor coefficients are e^β, and constant offsets, which may have either sign, β times their size. A
completed diagonal entry (a mass that torques cannot see) has its factor fixed to one, as the paper
does with α of the upper arm; completed rows come last. A small share of the prior is added,
x = (…)(π) + ε x_reg, which keeps x as far from the edge as the conic program does: both search the
same set.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import IdentificationError
from deltaid.estimation.objective import Objective, Solution
from deltaid.estimation.reduction import INTERIOR, Reduction
from deltaid.estimation.regularizer import Vector
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia
from deltaid.robot.parameter import Parameter


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
        """A minimum near the path of relaxed regularisers; errors as of `Solver.solve`."""
        from scipy import optimize  # slow to load, and seldom needed

        chart = LogCholeskyMap(objective.reduction)
        pi, iterations, message = chart.pi(objective.reduction.prior), 0, ""
        # Tenfold steps from a strong regulariser down to γ.
        steps = max(0, int(np.ceil(np.log10(self.strong / objective.gamma))))
        for k in range(steps, -1, -1):
            gamma = objective.gamma * 10.0**k
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
                    "maxiter": self.iterations if k else self.last_iterations,
                },
            )
            pi, iterations, message = result.x, iterations + int(result.nit), str(result.message)
        x = chart.x(pi)
        return Solution(x, objective.value(x), -np.inf, iterations, message.rstrip("."))


class Unconstrained:
    """J(π)/γ with gradient and Hessian; keeps the last point, which all three share.

    Where an exponential overflows, J is infinite, so that every method shortens its step; a NaN
    compares as false and would be taken for a step down.
    """

    def __init__(self, objective: Objective, chart: "LogCholeskyMap") -> None:
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


class LogCholeskyMap:
    """The map x(π), one to one from Rⁿ onto the consistent x, with exact derivatives.

    Raises:
        IdentificationError: the entries left free do not form a pattern that a Cholesky factor has.
    """

    def __init__(self, reduction: Reduction) -> None:
        self.reduction = reduction
        self._pi = ca.SX.sym("pi", reduction.size)
        entries = ca.SX(reduction.size, 1)
        for body in reduction.layout.bodies:
            for k, value in self._body_entries(body).items():
                entries[k] = value
        for k, variable in self._coefficients():
            pi = self._pi[k]
            entries[k] = variable.scale * pi if variable.signed else ca.exp(pi)
        self._x = entries + INTERIOR * ca.DM(reduction.prior)

    def x(self, pi: Vector) -> Vector:
        return np.asarray(self._functions(pi, np.zeros(len(pi)))[0]).ravel()

    def derivatives(self, pi: Vector, weights: Vector) -> tuple[Vector, np.ndarray, np.ndarray]:
        """x, ∂x/∂π and Σ_i weights_i ∂²x_i/∂π²."""
        x, J, H = (np.asarray(value) for value in self._functions(pi, weights))
        return x.ravel(), J, H

    def pi(self, x: Vector) -> Vector:
        """π(x), by Cholesky factorisation; an IdentificationError where x is not consistent."""
        reduction, pi = self.reduction, np.empty(len(x))
        inner = x - INTERIOR * reduction.prior
        p = reduction.A @ inner + reduction.p_0
        for body in reduction.layout.bodies:
            for k, value in self._body_coordinates(body, p).items():
                pi[k] = value
        for k, variable in self._coefficients():
            pi[k] = inner[k] / variable.scale if variable.signed else np.log(inner[k])
        return pi

    def _coefficients(self) -> list[tuple[int, Parameter]]:
        """The free variables that are no entries of a body, with their positions."""
        return [(k, v) for k, v in enumerate(self.reduction.variables) if v.kind != "inertia"]

    @cached_property
    def _functions(self) -> ca.Function:
        weights = ca.SX.sym("w", self.reduction.size)
        H, _ = ca.hessian(ca.dot(weights, self._x), self._pi)
        J = ca.jacobian(self._x, self._pi)
        return ca.Function("map", [self._pi, weights], [ca.densify(e) for e in (self._x, J, H)])

    def _order(self, body: str) -> list[int]:
        completed = self.reduction.completed[body]
        return [i for i in range(4) if i not in completed] + list(completed)

    def _body_entries(self, body: str) -> dict[int, ca.SX]:
        """Free entries of M̄(π) of one body, by position."""
        free, order = self.reduction.entries(body), self._order(body)
        if not free:
            return {}
        alpha = self._pi[free[3, 3]] if (3, 3) in free else ca.SX(0)
        U = ca.SX(4, 4)
        for a, i in enumerate(order):
            d = self._pi[free[i, i]] if (i, i) in free and i != 3 else ca.SX(0)
            U[a, a] = ca.exp(d)
            for b in range(a + 1, 4):
                place = min(i, order[b]), max(i, order[b])
                if place in free:
                    U[a, b] = self._pi[free[place]]
        M = ca.exp(2 * alpha) * (U.T @ U)
        place_in = {i: a for a, i in enumerate(order)}
        entries = {}
        for entry, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            value = M[place_in[i], place_in[j]]
            if (i, j) in free:
                entries[free[i, j]] = value
                continue
            if i == j:
                fixed = i not in self.reduction.completed[body]
                why = f"{entry}, which torques show, at its prior"
            else:
                fixed = ca.sparsify(value).nnz() > 0
                why = f"{entry} at zero while its neighbours are free"
            if fixed:
                raise IdentificationError(
                    f"log-cholesky cannot hold {why}",
                    where=f"bodies.{body}.free",
                    cure=f"free {entry} too, or use --method conic",
                )
        return entries

    def _body_coordinates(self, body: str, p: Float[np.ndarray, " parameters"]) -> dict[int, float]:
        """α, d, s, t of one body from its parameters: the Cholesky factor of M̄, row by row.

        Completed rows take no part in the factorisation; only their coupling is read.
        """
        free, order = self.reduction.entries(body), self._order(body)
        if not free:
            return {}
        M = pseudo_inertia(p[self.reduction.layout.body(body)])[np.ix_(order, order)]
        known = 4 - len(self.reduction.completed[body])
        if known and np.linalg.eigvalsh(M[:known, :known])[0] <= 0:
            raise IdentificationError(
                "is not consistent, so it has no log-Cholesky factor",
                where=f"bodies.{body}",
                cure="change its prior, or use --method conic",
            )
        U = np.zeros((4, 4))
        if known:
            U[:known, :known] = C = np.linalg.cholesky(M[:known, :known]).T
            U[:known, known:] = np.linalg.solve(C.T, M[:known, known:])
        alpha = np.log(U[order.index(3), order.index(3)]) if (3, 3) in free else 0.0
        U *= np.exp(-alpha)
        coordinates = {}
        for (i, j), k in free.items():
            a, b = sorted((order.index(i), order.index(j)))
            value = U[a, b] if a != b else (alpha if i == 3 else np.log(U[a, a]))
            coordinates[k] = float(value)
        return coordinates
