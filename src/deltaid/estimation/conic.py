"""The consistent fit as a conic program: the global optimum of (15), with a certificate.

J is convex in x, and consistency is a product of positive semidefinite cones and half lines, so an
interior-point method ends at the global optimum with a dual bound below it. Steps:

1. Stack data and quadratic regulariser and factor: J/γ = ‖R x − b‖² + spectral part + constant.
2. If there is no spectral part and the unconstrained minimiser is consistent, it is the optimum.
3. Otherwise solve  min ‖y‖² + spectral part  s.t.  y = R x − b,  M_b(x) − ε M_b,reg ⪰ 0.
4. Report J(x) and its distance from the dual bound.

The entropic part needs −log det A of the normalised block A: with Z lower triangular and
[[A, Z], [Zᵀ, diag Z]] ⪰ 0, log det A = max Σ log Z_ii (exponential cones).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import clarabel
import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.estimation.free_body import Affine, Block
from deltaid.estimation.objective import DataTerm, Objective, Solution
from deltaid.estimation.reduction import INTERIOR
from deltaid.estimation.regularizer import LOG_DET, Vector


@dataclass(frozen=True)
class Conic:
    """The global optimum of (15) for a regulariser that is convex, with its certificate.

    Attributes:
        tolerance: of the interior-point method, in gap and feasibility.
        largest_gap: a result with a larger gap, as a share of J plus the regulariser's unit γ, is
            refused.
    """

    tolerance: float = 1e-9
    largest_gap: float = 1e-5
    certifies: ClassVar[bool] = True

    def solve(self, objective: Objective) -> Solution:
        """The global optimum; errors as of `Solver.solve`."""
        spectral = objective.regularizer.spectral
        if not (spectral is None or spectral.divergence is LOG_DET):
            raise IdentificationError(
                "this regulariser is not convex in the parameters, so it has no conic program",
                cure="use --method log-cholesky with it, or the entropic regulariser, which is "
                "close to the Riemannian",
            )
        quadratic = _stacked(objective)
        if spectral is None:
            x = _unconstrained(quadratic)
            if x is not None and all(_interior(block, x) for block in objective.reduction.blocks):
                value = objective.value(x)
                return Solution(x, value, value, 0, "interior optimum")
        return _Program(objective, quadratic, self).solve()


def _stacked(objective: Objective) -> DataTerm:
    """Data and quadratic regulariser as one square, divided by γ."""
    data, prior, root = objective.data, objective.regularizer.quadratic, np.sqrt(objective.gamma)
    rows = [
        np.column_stack([data.R / root, data.b / root]),
        np.column_stack([prior.D, prior.D @ prior.x_reg]),
    ]
    return DataTerm.of(np.vstack(rows), data.c / objective.gamma)


def _unconstrained(quadratic: DataTerm) -> Vector | None:
    if np.min(np.abs(np.diag(quadratic.R))) == 0:
        return None
    return solve_triangular(quadratic.R, quadratic.b)


def _interior(block: Block, x: Vector) -> bool:
    return bool(np.linalg.eigvalsh(block.normalised_at(x))[0] > INTERIOR)


class _Program:
    """Assembles min ½ uᵀP u + qᵀu s.t. A u + s = b, s in cones, for u = [x/scale, y, Z, t]."""

    def __init__(self, objective: Objective, quadratic: DataTerm, settings: Conic) -> None:
        self._objective, self._quadratic, self._settings = objective, quadratic, settings
        self._reduction = objective.reduction
        self._size = 2 * objective.reduction.size
        self._rows: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        self._cones: list[object] = []
        self._linear: dict[int, float] = {}
        self._constant = 0.0

    def solve(self) -> Solution:
        n, spectral = self._reduction.size, self._objective.regularizer.spectral
        R = self._quadratic.R * self._reduction.scale
        self._require(np.hstack([R, -np.eye(n)]), self._quadratic.b, clarabel.ZeroConeT(n))
        if spectral is None:
            for block in self._reduction.blocks:
                variables, constant, slopes = self._affine(block)
                lowest = INTERIOR * np.eye(len(constant))
                self._require_psd(constant - lowest, variables, slopes)
        else:
            for block, weight in zip(spectral.blocks, spectral.weights, strict=True):
                self._add_entropy(block, weight)
        return self._run()

    def _run(self) -> Solution:
        n, size, gamma = self._reduction.size, self._size, self._objective.gamma
        diagonal, q = np.zeros(size), np.zeros(size)
        diagonal[n : 2 * n] = 2.0
        q[list(self._linear)] = list(self._linear.values())
        right = np.concatenate(self._right)
        left, first = np.zeros((len(right), size)), 0
        for rows in self._rows:
            left[first : first + len(rows), : rows.shape[1]] = rows
            first += len(rows)
        solution = clarabel.DefaultSolver(
            sparse.diags(diagonal, format="csc"),
            q,
            sparse.csc_matrix(left),
            right,
            self._cones,
            quiet_settings(self._settings.tolerance),
        ).solve()
        x = np.array(solution.x)[:n] * self._reduction.scale
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

    def _require(self, rows: np.ndarray, right: np.ndarray, cone: object) -> None:
        """right − rows · u in the cone; rows may be shorter than u."""
        self._rows.append(rows)
        self._right.append(right)
        self._cones.append(cone)

    def _affine(self, block: Block) -> Affine:
        """A normalised block over variables of u."""
        variables, constant, slopes = block.normalised
        return variables, constant, slopes * self._reduction.scale[variables, None, None]

    def _require_psd(
        self, constant: np.ndarray, variables: np.ndarray, slopes: Float[np.ndarray, "own k k"]
    ) -> None:
        right = svec(constant)
        rows = np.zeros((len(right), self._size))
        rows[:, variables] = -svec(slopes).T
        self._require(rows, right, definite(len(constant)))

    def _add_entropy(self, block: Block, weight: float) -> None:
        """2 w (tr A − log det A − k) of the normalised block A, with a weight w."""
        variables, constant, slopes = self._affine(block)
        k, corners = len(constant), _corners(len(constant))
        self._constant += 2 * weight * (np.trace(constant) - k)
        traces = np.trace(slopes, axis1=1, axis2=2).tolist()
        for variable, trace in zip(variables.tolist(), traces, strict=True):
            self._linear[variable] = self._linear.get(variable, 0.0) + 2 * weight * trace
        Z = self._size + np.arange(len(corners))
        diagonal = Z[np.any(corners[:, range(k, 2 * k), range(k, 2 * k)], axis=1)].tolist()
        self._size += len(corners) + k
        t = range(self._size - k, self._size)
        wide = np.pad(slopes, ((0, 0), (0, k), (0, k)))
        self._require_psd(
            np.pad(constant, (0, k)), np.append(variables, Z), np.concatenate([wide, corners])
        )
        for i in range(k):
            rows = np.zeros((3, self._size))
            rows[0, t[i]] = rows[2, diagonal[i]] = -1.0
            self._require(rows, np.array([0.0, 1.0, 0.0]), clarabel.ExponentialConeT())
            self._linear[t[i]] = -2.0 * weight


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
    rows, columns, factors = _upper(M.shape[-1])
    return factors * M[..., columns, rows]


@lru_cache
def _upper(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of a lower triangle row by row, and their factors."""
    rows, columns = np.tril_indices(k)  # of the transpose: upper triangle by columns
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def definite(size: int) -> object:
    """The cone of positive semidefinite matrices; of one entry, the half line."""
    return clarabel.NonnegativeConeT(1) if size == 1 else clarabel.PSDTriangleConeT(size)


def quiet_settings(tolerance: float) -> clarabel.DefaultSettings:
    """Settings of Clarabel with one tolerance for gap and feasibility."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return settings
