"""The consistent fit, eq. (15), written down a second time, as a CVXPY problem.

It shares with deltaid's own fit what the problem is about: the robot's description, the drives'
factors, the bodies' pseudo-inertia matrices (12) as functions of their ten parameters, and the
margin ε. How the free entries act on p, which matrices must be positive definite, the data term
and the regularisers are written here once more, from the definitions and in a different form:
whole bodies instead of their smallest blocks, relative changes instead of parameters. So an
agreement of both optima says that neither problem was put together wrongly.
"""

from dataclasses import dataclass
from typing import Literal

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.estimation.information import Information
from deltaid.estimation.scatter import inverse
from deltaid.levels import FAINT
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia

Array = NDArray[np.float64]
Metric = Literal["euclidean", "entropic"]

SETTINGS: dict[str, dict[str, object]] = {
    "CLARABEL": {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9},
    "SCS": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iters": 100_000},
}


@dataclass(frozen=True)
class CvxpySolution:
    """What CVXPY came back with.

    Attributes:
        x: the free variables, in the order of `CvxpyFit.names`.
        objective: J as CVXPY evaluates its own problem, constants included.
        solver_seconds: what the solver says it took, without CVXPY's own work.
        status: what CVXPY said.
    """

    x: Array
    objective: float
    solver_seconds: float
    status: str


@dataclass(frozen=True)
class _Body:
    """Normalised M̄ of a body, A = I + Σ u_k N_k over its visible rows; N has vec(N_k) in column k.

    `loose` are variables of the body that stand in no such matrix, as they couple with a mass or
    second moment that torques cannot see.
    """

    size: int
    variables: list[int]
    N: Array
    loose: list[int]


class CvxpyFit:
    """What the robot alone decides; `solve` does everything that depends on the data.

    x = x_reg + scale · u, with scale_k = √(M_ii M_jj) of the prior for entry (i, j) of a body's M̄
    and the prior itself for a coefficient. p = p_reg + B u.
    """

    def __init__(self, robot: RobotDescription, columns: NDArray[np.int_]) -> None:
        layout = parameter_layout(robot)
        self.p_reg = prior_parameters(robot)
        self.names: list[str] = []
        self._x_reg: list[float] = []
        self._scale: list[float] = []
        self._bodies: list[_Body] = []
        changes: list[Array] = []
        weights = np.abs(self.p_reg)
        for body in layout.bodies:
            part = layout.body(body)
            visible = np.isin(np.arange(part.start, part.stop), columns)
            changes += self._add_body(robot, body, part, visible)
            weights[part] = _scales(self.p_reg[part])
        self._coefficients = [len(self.names) + i for i in range(len(layout.names) - part.stop)]
        for i in range(part.stop, len(layout.names)):
            self.names.append(layout.names[i])
            self._x_reg.append(self.p_reg[i])
            self._scale.append(self.p_reg[i])
            changes.append(self.p_reg[i] * np.eye(len(self.p_reg))[i])
        self._B = np.column_stack(changes)
        touched = np.abs(self._B).max(axis=1) > 0
        self._pull = self._B[touched] / weights[touched, None]

    def solve(
        self, information: Information, gamma: float, metric: Metric, solver: str
    ) -> CvxpySolution:
        u = cp.Variable(len(self.names))
        K, k, constant = self._data(information)
        terms = [cp.sum_squares((K @ u - k) / np.sqrt(gamma))]
        constraints: list[cp.Constraint] = []
        if metric == "euclidean":
            terms.append(cp.sum_squares(self._pull @ u))
            constraints += [A >> FAINT * np.eye(A.shape[0]) for A in self._matrices(u)]
            constraints.append(1 + u[self._coefficients] >= FAINT)
        else:
            terms += self._entropic(u)
        problem = cp.Problem(cp.Minimize(cp.sum(cp.hstack(terms))), constraints)
        problem.solve(solver=solver, **SETTINGS[solver])
        return CvxpySolution(
            x=np.array(self._x_reg) + np.array(self._scale) * u.value,
            objective=gamma * float(problem.value) + constant,
            solver_seconds=float(problem.solver_stats.solve_time),
            status=str(problem.status),
        )

    def _add_body(
        self, robot: RobotDescription, body: str, part: slice, visible: NDArray[np.bool_]
    ) -> list[Array]:
        """Take in the free entries of one body; what each does to p."""
        M = pseudo_inertia(self.p_reg[part])
        changes, units, hidden = [], [], []
        for entry, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = np.sqrt(M[i, i] * M[j, j])
            effect = inertia_parameters(unit)
            if entry in robot.bodies[body].free:
                changes.append(np.zeros(len(self.p_reg)))
                changes[-1][part] = effect
                units.append((len(self.names), unit))
                self.names.append(f"{body}.{entry}")
                self._x_reg.append(M[i, j])
                self._scale.append(unit[i, j])
            elif i == j and not np.any(visible & (effect != 0)):
                hidden.append(i)
        self._bodies.append(_normalised_body(M, units, hidden))
        return changes

    def _data(self, information: Information) -> tuple[Array, Array, float]:
        """K, k, c with ‖K u − k‖² + c = 1/s Σ_i ‖τ_i − Y_i p(u)‖² / τ_max,i².

        The constant c, most of J for noisy data, stays away from the solver, whose tolerances are
        shares of the objective that it sees.
        """
        rows = np.vstack(list(information.factors / information.torque_max[:, None, None]))
        Y, tau, seen = rows[:, :-1], rows[:, -1], information.columns
        Q, K = np.linalg.qr(Y @ self._B[seen] / np.sqrt(information.mean_samples))
        right = (tau - Y @ self.p_reg[seen]) / np.sqrt(information.mean_samples)
        k = Q.T @ right
        return K, k, float(np.sum((right - Q @ k) ** 2))

    def _matrices(self, u: cp.Variable) -> list[cp.Expression]:
        return [
            np.eye(b.size) + cp.reshape(b.N @ u[b.variables], (b.size, b.size), order="F")
            for b in self._bodies
            if b.variables
        ]

    def _entropic(self, u: cp.Variable) -> list[cp.Expression]:
        """2 (tr A − log det A − k) of bodies and coefficients, squares of the loose variables."""
        terms = [2 * (cp.trace(A) - cp.log_det(A) - A.shape[0]) for A in self._matrices(u)]
        change = u[self._coefficients]
        terms.append(2 * cp.sum(change - cp.log1p(change)))
        loose = [k for body in self._bodies for k in body.loose]
        if loose:
            terms.append(cp.sum_squares(self._pull[:, loose] @ u[loose]))
        return terms


def _normalised_body(M: Array, units: list[tuple[int, Array]], hidden: list[int]) -> _Body:
    rows = np.setdiff1d(np.arange(4), hidden)
    root = inverse(np.linalg.cholesky(M[np.ix_(rows, rows)]).T).T
    variables, loose, columns = [], [], []
    for k, unit in units:
        if np.any(unit[np.ix_(rows, rows)]):
            variables.append(k)
            columns.append((root @ unit[np.ix_(rows, rows)] @ root.T).ravel(order="F"))
        else:
            loose.append(k)
    N = np.column_stack(columns) if columns else np.zeros((len(rows) ** 2, 0))
    return _Body(len(rows), variables, N, loose)


def _scales(p: Array) -> Array:
    """What changes of a body's parameters count against: themselves, or m ℓ and m ℓ² where zero.

    ℓ is the radius of gyration about the link frame, ℓ² = tr Σ / m.
    """
    m, length = p[0], np.sqrt(np.trace(pseudo_inertia(p)[:3, :3]) / p[0])
    typical = np.concatenate([[m], np.full(3, m * length), np.full(6, m * length**2)])
    return np.where(p != 0, np.abs(p), typical)
