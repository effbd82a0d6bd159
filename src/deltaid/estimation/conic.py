"""The consistent fit as a conic program: the global optimum of (15), with a certificate.

J is convex in x, and consistency is a product of positive semidefinite cones and half lines, so an
interior-point method ends at the global optimum with a dual bound below it. Steps:

1. Stack data and quadratic regulariser and factor: J/γ = ‖R x − b‖² + spectral part + constant.
2. If there is no spectral part and the unconstrained minimiser is consistent, it is the optimum.
3. Otherwise solve  min ‖y‖² + spectral part  s.t.  y = R x − b,  M_b(x) − ε M_b,reg ⪰ 0.
4. Report J(x) and its distance from the dual bound.

The entropic part needs −log det A of the normalised block A: with Z lower triangular and
[[A, Z], [Zᵀ, diag Z]] ⪰ 0, log det A = max Σ log Z_ii (exponential cones).

The paper's route borrows this bound (`minimise`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import clarabel
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.estimation.log_cholesky import LogCholesky
from deltaid.estimation.objective import Objective, Quadratic, Solution, Solver, Vector
from deltaid.estimation.reduction import Affine, Block
from deltaid.levels import FAINT
from deltaid.model.options import Method


@dataclass(frozen=True)
class Conic:
    """The global optimum of (15) for a regulariser that is convex, with its certificate."""

    tolerance: float = 1e-9  # of the interior-point method, in gap and feasibility
    # a result with a larger gap, as a share of J plus the regulariser's unit γ, is refused
    largest_gap: float = 1e-5
    certifies: ClassVar[bool] = True

    def solve(self, objective: Objective) -> Solution:
        if not objective.regularizer.convex:
            raise IdentificationError(
                "this regulariser is not convex in the parameters, so it has no conic program",
                cure="use --method log-cholesky with it, or the entropic regulariser, which is "
                "close to the Riemannian",
            )
        quadratic = _stacked(objective)
        if objective.regularizer.spectral is None and np.all(np.diag(quadratic.R) != 0):
            x = solve_triangular(quadratic.R, quadratic.b)
            blocks = (block.normalised_at(x) for block in objective.reduction.blocks)
            if all(np.linalg.eigvalsh(block)[0] > FAINT for block in blocks):
                value = objective.value(x)
                return Solution(x, value, value, 0, "interior optimum")
        return _Program(objective, quadratic, self).solve()


SOLVERS: dict[Method, Solver] = {"conic": Conic(), "log-cholesky": LogCholesky()}


def minimise(objective: Objective, solver: Solver) -> Solution:
    """Minimise J by a solver; one that does not certify borrows the bound of one that does. Errors
    as of `Solver.solve`."""
    solution = solver.solve(objective)
    if solver.certifies or not objective.regularizer.convex:
        return solution
    return replace(solution, bound=Conic().solve(objective).bound)


def _stacked(objective: Objective) -> Quadratic:
    """Data and quadratic regulariser as one square, divided by γ."""
    data, prior, root = objective.data, objective.regularizer.quadratic, np.sqrt(objective.gamma)
    rows = np.vstack(
        [np.column_stack([data.R, data.b]) / root, np.column_stack([prior.R, prior.b])]
    )
    return Quadratic.from_rows(rows, data.c / objective.gamma)


class _Program:
    """Assembles min ½ uᵀP u + qᵀu s.t. A u + s = b, s in cones, for u = [x/scale, y, Z, t]."""

    def __init__(self, objective: Objective, quadratic: Quadratic, settings: Conic) -> None:
        self._objective, self._quadratic, self._settings = objective, quadratic, settings
        self._scale, n = objective.reduction.scale, objective.reduction.size
        self._q, self._constant = np.zeros(2 * n), 0.0
        # right − rows · u is in the cone; rows may be shorter than u
        self._rows = [np.hstack([quadratic.R * self._scale, -np.eye(n)])]
        self._right, self._cones = [quadratic.b], list[object]([clarabel.ZeroConeT(n)])
        spectral = objective.regularizer.spectral
        if spectral is None:
            for block in objective.reduction.blocks:
                variables, constant, slopes = self._affine(block)
                self._require_psd(constant - FAINT * np.eye(len(constant)), variables, slopes)
        else:
            for block, weight in zip(spectral.blocks, spectral.weights, strict=True):
                self._add_entropy(block, weight)

    def solve(self) -> Solution:
        n, size, gamma = len(self._scale), len(self._q), self._objective.gamma
        rows = [np.pad(part, ((0, 0), (0, size - part.shape[1]))) for part in self._rows]
        solution = interior_point(
            self._q,
            np.vstack(rows),
            np.concatenate(self._right),
            self._cones,
            self._settings.tolerance,
            squares=np.repeat([0.0, 2.0, 0.0], [n, n, size - 2 * n]),
        )
        x = np.array(solution.x)[:n] * self._scale
        value = self._objective.value(x) if np.all(np.isfinite(x)) else np.inf
        bound = gamma * (solution.obj_val_dual + self._quadratic.c + self._constant)
        status = str(solution.status)
        if not value - bound <= self._settings.largest_gap * (abs(value) + gamma):
            raise IdentificationError(
                f"the conic solver stopped without a certificate ({status}, objective "
                f"{value:.3g}, bound {bound:.3g})",
                cure="check sign and unit of torques and positions and the robot's lengths; where "
                "these are right, the data alone may leave the problem too flat: set a larger "
                "--gamma",
            )
        return Solution(x, value, bound, solution.iterations, status)

    def _affine(self, block: Block) -> Affine:
        """A normalised block over variables of u."""
        variables, constant, slopes = block.normalised
        return variables, constant, slopes * self._scale[variables, None, None]

    def _require_psd(
        self, constant: np.ndarray, variables: np.ndarray, slopes: Float[np.ndarray, "own k k"]
    ) -> None:
        rows = np.zeros((len(constant) * (len(constant) + 1) // 2, len(self._q)))
        rows[:, variables] = -svec(slopes).T
        self._rows.append(rows)
        self._right.append(svec(constant))
        self._cones.append(definite(len(constant)))

    def _add_entropy(self, block: Block, weight: float) -> None:
        """2 w (tr A − log det A − k) of the normalised block A, with a weight w."""
        variables, constant, slopes = self._affine(block)
        k, corners = len(constant), _corners(len(constant))
        self._constant += 2 * weight * (np.trace(constant) - k)
        Z, t = np.split(len(self._q) + np.arange(len(corners) + k), [len(corners)])
        self._q = np.append(self._q, np.repeat([0.0, -2.0 * weight], [len(Z), k]))
        self._q[variables] += 2 * weight * np.trace(slopes, axis1=1, axis2=2)
        wide = np.pad(slopes, ((0, 0), (0, k), (0, k)))
        self._require_psd(
            np.pad(constant, (0, k)), np.append(variables, Z), np.concatenate([wide, corners])
        )
        diagonal = Z[corners[:, range(k, 2 * k), range(k, 2 * k)].any(axis=1)]
        rows, right, cones = below_logarithm(t, diagonal, len(self._q))
        self._rows.append(rows)
        self._right.append(right)
        self._cones.extend(cones)


@lru_cache
def _corners(k: int) -> Float[np.ndarray, "entries wide wide"]:
    """Slopes of [[A, Z], [Zᵀ, diag Z]] along the entries of Z, column by column."""
    places = [(i, j) for j in range(k) for i in range(j, k)]
    slopes = np.zeros((len(places), 2 * k, 2 * k))
    for slope, (i, j) in zip(slopes, places, strict=True):
        slope[i, k + j] = slope[k + j, i] = 1.0
        if i == j:
            slope[k + i, k + i] = 1.0
    return slopes


def svec(M: Float[np.ndarray, "*many k k"]) -> Float[np.ndarray, "*many entries"]:
    """Upper triangle column by column, off-diagonal entries times √2, as Clarabel wants it."""
    rows, columns = np.tril_indices(M.shape[-1])  # of the transpose: upper triangle by columns
    return np.where(rows == columns, 1.0, np.sqrt(2.0)) * M[..., columns, rows]


def definite(size: int) -> object:
    """The cone of positive semidefinite matrices; of one entry, the half line."""
    return clarabel.NonnegativeConeT(1) if size == 1 else clarabel.PSDTriangleConeT(size)


def below_logarithm(
    logs: Int[np.ndarray, " k"], values: Int[np.ndarray, " k"], size: int
) -> tuple[Float[np.ndarray, "rows u"], Vector, list[object]]:
    """Rows, right side and cones of u[log] ≤ log u[value], for places in u of some size."""
    rows, each = np.zeros((len(logs), 3, size)), np.arange(len(logs))
    rows[each, 0, logs] = rows[each, 2, values] = -1.0
    right = np.tile([0.0, 1.0, 0.0], len(logs))
    return rows.reshape(-1, size), right, [clarabel.ExponentialConeT() for _ in logs]


def interior_point(
    q: Vector,
    A: Float[np.ndarray, "rows n"],
    b: Float[np.ndarray, " rows"],
    cones: list[object],
    tolerance: float | None = None,
    squares: Vector | None = None,
) -> clarabel.DefaultSolution:
    """Clarabel's minimum of ½ uᵀ diag(squares) u + qᵀu where b − A u is in the cones, with one
    tolerance for gap and feasibility, or Clarabel's own; linear without squares."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    P = sparse.csc_matrix((len(q), len(q))) if squares is None else sparse.diags(squares)
    problem = P.tocsc(), q, sparse.csc_matrix(A), b, cones, settings
    return clarabel.DefaultSolver(*problem).solve()
