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
from functools import lru_cache
from typing import ClassVar

import casadi as ca
import numpy as np

from deltaid.errors import IdentificationError
from deltaid.estimation.objective import Matrix, Objective, Solution, Vector
from deltaid.estimation.reduction import Reduction
from deltaid.levels import FAINT
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, pseudo_inertia
from deltaid.robot.parameter import PriorParameter

# γ where the relaxation starts.
_STRONG = 1e-2


@dataclass(frozen=True)
class LogCholesky:
    """A minimum of J(π), eq. (15), by a trust-region Newton method with exact Hessians.

    Starts at the prior, π₀ = argmin ‖p(π) − p_reg‖ (Sec. VIII B), which the Cholesky factor gives
    exactly. On the way an exponential may run towards zero, where its gradient dies and the
    iteration with it; so the regulariser starts strong, where the minimum is near the prior, and is
    relaxed tenfold at a time to the γ asked for. The solution's bound is −∞: this route has no
    certificate of its own. `visit` is called with π after every iteration.
    """

    visit: Callable[[Vector], None] = lambda _: None
    certifies: ClassVar[bool] = False

    def solve(self, objective: Objective) -> Solution:
        """A minimum near the path of relaxed regularisers; errors as of `Solver.solve`."""
        from scipy import optimize  # slow to load, and seldom needed

        chart = LogCholeskyMap(objective.reduction)
        pi, iterations, message = chart.pi(objective.reduction.prior), 0, ""
        steps = max(0, int(np.ceil(np.log10(_STRONG / objective.gamma))))
        for k in range(steps, -1, -1):
            problem = Unconstrained(replace(objective, gamma=objective.gamma * 10.0**k), chart)
            result = optimize.minimize(
                problem.value,
                pi,
                method="trust-exact",
                jac=problem.gradient,
                hess=problem.hessian,
                callback=self.visit,
                options={"gtol": FAINT, "maxiter": 15 if k else 500},
            )
            pi, iterations, message = result.x, iterations + int(result.nit), str(result.message)
        x = chart.x(pi)
        return Solution(x, objective.value(x), -np.inf, iterations, message.rstrip("."))


class Unconstrained:
    """J(π)/γ with gradient and Hessian; all three share the evaluation of the last point.

    Where an exponential overflows, J is infinite, so that every method shortens its step; a NaN
    compares as false and would be taken for a step down.
    """

    def __init__(self, objective: Objective, chart: "LogCholeskyMap") -> None:
        self._objective, self._chart = objective, chart
        self._evaluated = lru_cache(maxsize=1)(self._evaluate)

    def value(self, pi: Vector) -> float:
        return self._evaluated(pi.tobytes())[0]

    def gradient(self, pi: Vector) -> Vector:
        return self._evaluated(pi.tobytes())[1]

    def hessian(self, pi: Vector) -> Matrix:
        return self._evaluated(pi.tobytes())[2]

    def _evaluate(self, point: bytes) -> tuple[float, Vector, Matrix]:
        pi, scale = np.frombuffer(point), self._objective.gamma  # brings the regulariser to about 1
        with np.errstate(over="ignore", invalid="ignore"):
            value, g, H = self._objective.evaluate(self._chart.x(pi))
            _, J, second = self._chart.derivatives(pi, g)
            value = value if np.isfinite(value) else np.inf
            return value / scale, J.T @ g / scale, (J.T @ H @ J + second) / scale


class LogCholeskyMap:
    """The map x(π), one to one from Rⁿ onto the consistent x, with exact derivatives.

    Raises:
        IdentificationError: the entries left free do not form a pattern that a Cholesky factor has.
    """

    def __init__(self, reduction: Reduction) -> None:
        self.reduction = reduction
        pi, weights = (ca.SX.sym(name, reduction.size) for name in ("pi", "w"))
        x = ca.SX(reduction.size, 1)
        for body in reduction.layout.bodies:
            for k, value in self._body_entries(body, pi).items():
                x[k] = value
        for k, variable in self._coefficients():
            x[k] = variable.scale * pi[k] if variable.signed else ca.exp(pi[k])
        x += FAINT * ca.DM(reduction.prior)
        outputs = x, ca.jacobian(x, pi), ca.hessian(ca.dot(weights, x), pi)[0]
        self._function = ca.Function("map", [pi, weights], [ca.densify(e) for e in outputs])

    def x(self, pi: Vector) -> Vector:
        return self.derivatives(pi, np.zeros(len(pi)))[0]

    def derivatives(self, pi: Vector, weights: Vector) -> tuple[Vector, Matrix, Matrix]:
        """x, ∂x/∂π and Σ_i weights_i ∂²x_i/∂π²."""
        x, J, H = (np.asarray(value) for value in self._function(pi, weights))
        return x.ravel(), J, H

    def pi(self, x: Vector) -> Vector:
        """π(x), by Cholesky factorisation; an IdentificationError where x is not consistent."""
        reduction, pi = self.reduction, np.empty(len(x))
        inner = x - FAINT * reduction.prior
        p = reduction.A @ inner + reduction.p_0
        for body in reduction.layout.bodies:
            for k, value in self._body_coordinates(body, p).items():
                pi[k] = value
        for k, variable in self._coefficients():
            pi[k] = inner[k] / variable.scale if variable.signed else np.log(inner[k])
        return pi

    def _coefficients(self) -> list[tuple[int, PriorParameter]]:
        """The free variables that are no entries of a body, with their positions."""
        return [(k, v) for k, v in enumerate(self.reduction.variables) if v.kind != "inertia"]

    def _places(self, body: str) -> tuple[list[int], dict[tuple[int, int], int]]:
        """Rows of M̄ with completed ones last, and positions in x of free entries by their places
        (a ≤ b) in this order."""
        completed = self.reduction.completed[body]
        order = [*(i for i in range(4) if i not in completed), *completed]
        free = dict[tuple[int, int], int]()
        for k, variable in enumerate(self.reduction.variables):
            if variable.kind == "inertia" and variable.owner == body:
                a, b = sorted(map(order.index, PSEUDO_INERTIA_ENTRIES[variable.symbol]))
                free[a, b] = k
        return order, free

    def _body_entries(self, body: str, pi: ca.SX) -> dict[int, ca.SX]:
        """Free entries of M̄(π) of one body, by position."""
        order, free = self._places(body)
        if not free:
            return {}
        mass = order.index(3)
        U = ca.SX.eye(4)
        for (a, b), k in free.items():
            if a != b or a != mass:
                U[a, b] = pi[k] if a != b else ca.exp(pi[k])
        alpha = pi[free[mass, mass]] if (mass, mass) in free else 0
        M = ca.exp(2 * alpha) * (U.T @ U)
        for entry, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            a, b = sorted((order.index(i), order.index(j)))
            if (a, b) in free:
                continue
            if i == j:
                fixed = i not in self.reduction.completed[body]
                why = f"{entry}, which torques show, at its prior"
            else:
                fixed = ca.sparsify(M[a, b]).nnz() > 0
                why = f"{entry} at zero while its neighbours are free"
            if fixed:
                raise IdentificationError(
                    f"log-cholesky cannot hold {why}",
                    where=f"bodies.{body}.free",
                    cure=f"free {entry} too, or use --method conic",
                )
        return {k: M[a, b] for (a, b), k in free.items()}

    def _body_coordinates(self, body: str, p: Vector) -> dict[int, float]:
        """α, d, s, t of one body from its parameters: the Cholesky factor of M̄, row by row; of
        completed rows only the coupling is read."""
        order, free = self._places(body)
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
        U[:known] = np.linalg.solve(np.linalg.cholesky(M[:known, :known]), M[:known])
        mass = order.index(3)
        alpha = np.log(U[mass, mass]) if (mass, mass) in free else 0.0
        U *= np.exp(-alpha)
        coordinates = {k: U[a, b] if a != b else np.log(U[a, a]) for (a, b), k in free.items()}
        if (mass, mass) in free:
            coordinates[free[mass, mass]] = alpha
        return {k: float(value) for k, value in coordinates.items()}
