"""Linear functions over a ball of data and the cones of physical consistency."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import clarabel
import numpy as np
from jaxtyping import Bool, Float

from deltaid.estimation.conic import definite, interior_point, svec
from deltaid.estimation.objective import Vector
from deltaid.estimation.reduction import Block
from deltaid.levels import NEGLIGIBLE

# Accuracy of ends, as a share: where cones touch the ball, they are as accurate as the root of the
# solver's tolerance.
ACCURACY = 1e-3


class ConsistentBall:
    """All x in the cones of some blocks with ‖R x − b‖² ≤ m² + t², m² the least left side.

    With R = U S Vᵀ and x = V_1 S⁻¹ (v + U_1ᵀb) + V_2 a, data is a ball ‖v‖ ≤ r, and a is free
    within the cones: a linear function over a ball and cones is minimised (Clarabel).
    """

    def __init__(
        self,
        R: Float[np.ndarray, "rows n"],
        b: Float[np.ndarray, " rows"],
        blocks: Sequence[Block],
        scale: Vector,
    ) -> None:
        size = np.linalg.norm(R, axis=0)
        scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), scale)
        U, S, Vt = np.linalg.svd(R * scale)
        self.rank = rank = int(np.sum(S / S[0] > NEGLIGIBLE))
        # x = centre + map (v, a)
        determined = Vt[:rank].T / S[:rank]
        self.map = scale[:, None] * np.hstack([determined, Vt[rank:].T])
        self._centre = scale * (determined @ (U[:, :rank].T @ b))
        # Rows of the ball, the first for its radius, and of the cones.
        ball = np.eye(rank + 1, self.map.shape[1], -1)
        parts = [(-ball, np.zeros(rank + 1), clarabel.SecondOrderConeT(rank + 1))]
        cones = (self._cone(block, size > 0) for block in blocks)
        parts += [cone for cone in cones if cone is not None]
        rows, right, self._cones = zip(*parts, strict=True)
        self._rows, self._right = np.concatenate(rows), np.concatenate(right)

    def ends(self, c: Vector, t: float) -> Float[np.ndarray, " 2"]:
        """Least and largest c·x; infinite where there is none."""
        cost = self.map.T @ c
        size, radius = float(np.linalg.norm(cost)), float(np.hypot(self._least, t))
        if size == 0:
            return np.full(2, float(c @ self._centre))
        ends = [self._solve(sign * cost / size, self._rows, radius) for sign in (1.0, -1.0)]
        low, high = (size * float(end.obj_val) if _is_known(end) else -np.inf for end in ends)
        return float(c @ self._centre) + np.array([low, -high])

    @cached_property
    def _least(self) -> float:
        """m, the distance of the consistent x from the least-squares values of the data."""
        wide = np.pad(self._rows, ((0, 0), (0, 1)))
        wide[0, -1] = -1.0
        return float(self._solve(np.eye(wide.shape[1])[-1], wide, 0.0).obj_val)

    def _solve(
        self, cost: Vector, rows: Float[np.ndarray, "rows n"], radius: float
    ) -> clarabel.DefaultSolution:
        right = self._right.copy()
        right[0] = radius
        return interior_point(cost, rows, right, list(self._cones))

    def _cone(
        self, block: Block, determined: Bool[np.ndarray, " n"]
    ) -> tuple[np.ndarray, np.ndarray, object] | None:
        """Rows, right side and cone of M_b(x) ⪰ 0, relative to its prior.

        A moment that the data do not determine can be as large as needed, so it has no row.
        """
        diagonal = np.diag(block.index)
        inner = np.ix_(*[np.flatnonzero((diagonal < 0) | determined[diagonal])] * 2)
        if np.all(block.index[inner] < 0):
            return None
        M = block.matrix(self._centre)
        part = replace(block, index=block.index[inner], constant=M[inner], prior=block.prior[inner])
        columns, at_centre, slopes = part.normalised
        rows, right = -svec(slopes).T @ self.map[columns], svec(at_centre)
        size = max(float(np.abs(rows).max()), float(np.abs(right).max()))
        return rows / size, right / size, definite(len(at_centre))


def _is_known(end: clarabel.DefaultSolution) -> bool:
    """Whether the dual bound agrees to the accuracy of ranges, also where rounding stopped the
    solver before its tolerance; not without an optimum, where both are no numbers."""
    return abs(end.obj_val - end.obj_val_dual) <= ACCURACY * max(1.0, abs(end.obj_val))
