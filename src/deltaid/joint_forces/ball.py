"""The largest value of a linear function over a ball and the cones of physical consistency."""

from functools import cached_property

import clarabel
import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

from deltaid.errors import IdentificationError
from deltaid.estimation.conic import definite, interior_point, svec
from deltaid.estimation.information import triangle
from deltaid.estimation.scatter import NORMAL
from deltaid.joint_forces.unknowns import ForceUnknowns

# The solver's tolerance, of values in standard deviations.
_TOLERANCE = 1e-9


class ConsistentBall:
    """Consistent unknowns with ‖R u − b‖² within the reach of the best."""

    def __init__(self, data: Float[np.ndarray, "rows augmented"], unknown: ForceUnknowns) -> None:
        n = len(unknown.names)
        prior = np.eye(n, n + 1)
        factor = triangle(np.vstack([data, prior]))
        self._R, self._b = factor[:n, :n], factor[:n, n]
        self._u = solve_triangular(self._R, self._b)
        self._blocks = unknown.blocks

    def largest(self, c: Float[np.ndarray, " n"]) -> float:
        """The largest value of c·u."""
        g = solve_triangular(self._R, c, trans="T")
        length = float(np.linalg.norm(g))
        if length == 0:
            return 0.0
        if self._consistent(self._u):
            u = self._u + solve_triangular(self._R, NORMAL * g / length)
            if self._consistent(u):
                return float(c @ u)
        v = self._solve(-g / length, self._radius)
        return float(c @ self._u + g @ v)

    @cached_property
    def _radius(self) -> float:
        """Radius √(m² + 1.96²) of the ball."""
        if self._consistent(self._u):
            return NORMAL
        return float(np.hypot(np.linalg.norm(self._solve(None, None)), NORMAL))

    def _consistent(self, u: Float[np.ndarray, " n"]) -> bool:
        return all(np.linalg.eigvalsh(block.matrix(u))[0] >= 0 for block in self._blocks)

    def _solve(
        self, cost: Float[np.ndarray, " n"] | None, radius: float | None
    ) -> Float[np.ndarray, " n"]:
        """v of least cost with ‖v‖ ≤ radius, or of least norm, among the consistent ones.

        The last variable t bounds the norm.
        """
        n = len(self._u)
        S = solve_triangular(self._R, np.eye(n))
        rows, right, cones = [np.zeros((n + 1, n + 1))], [np.zeros(n + 1)], []
        rows[0][0, n], rows[0][1:, :n] = -1.0, -np.eye(n)
        cones.append(clarabel.SecondOrderConeT(n + 1))
        if radius is not None:
            rows.append(np.eye(1, n + 1, n))
            right.append(np.array([radius]))
            cones.append(clarabel.ZeroConeT(1))
        for block in self._blocks:
            slopes = svec(block.slopes).T
            rows.append(np.hstack([-slopes @ S[list(block.at)], np.zeros((len(slopes), 1))]))
            right.append(svec(block.matrix(self._u)))
            cones.append(definite(len(block.constant)))
        q = np.append(np.zeros(n), 1.0) if cost is None else np.append(cost, 0.0)
        solution = interior_point(q, np.vstack(rows), np.concatenate(right), cones, _TOLERANCE)
        if str(solution.status) not in ("Solved", "AlmostSolved"):
            raise IdentificationError(
                f"the range of a force was not found: the solver ended with {solution.status}",
                where="--logs",
                cure="check that these are the recordings that the model was identified from",
            )
        return np.array(solution.x)[:n]
