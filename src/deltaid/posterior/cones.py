"""Whether many points at once lie in a product of cones of small symmetric matrices.

Every block M_b(y), affine in y, must be positive definite. Entries of all blocks are numbers in one
array, a row an entry and a column a point; elimination runs over blocks of one size and all points
together, with no loop but over rows and columns of a block.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.estimation.reduction import INTERIOR, Reduction
from deltaid.estimation.scatter import inverse

Entries = Float[np.ndarray, "entries points"]


@dataclass(frozen=True, eq=False)
class Cones:
    """Blocks C_b + Σ y_k S_bk ≻ 0, each written as the entries of its lower triangle."""

    constant: Float[np.ndarray, " entries"]  # entries at y = 0
    slopes: Float[np.ndarray, "entries n"]  # by how much each changes with y
    # for each size of blocks, the place of every entry (row, column, block)
    groups: tuple[Int[np.ndarray, "_ _ _"], ...]

    @classmethod
    def of(
        cls,
        reduction: Reduction,
        mean: Float[np.ndarray, " n"],
        root: Float[np.ndarray, "n n"],
    ) -> "Cones":
        """Those of x = mean + root·y, as the fit has them, each seen from its prior.

        Upper bounds of coefficients are blocks too.
        """
        blocks = [
            (variables, fixed - INTERIOR * np.eye(len(fixed)), per_variable)
            for variables, fixed, per_variable in (b.normalised for b in reduction.blocks)
        ]
        for k, variable in enumerate(reduction.variables):
            if np.isfinite(variable.high):
                bound, slope = np.array([[variable.high]]), np.array([[[-1.0]]])
                blocks.append((np.array([k]), bound / variable.scale, slope / variable.scale))
        entries, places, count = list[np.ndarray](), dict[int, list[np.ndarray]](), 0
        for variables, fixed, per_variable in blocks:
            k = len(fixed)
            i, j = np.tril_indices(k)
            place = np.zeros((k, k), dtype=int)
            place[i, j] = place[j, i] = count + np.arange(len(i))
            count += len(i)
            own = per_variable[:, i, j].T @ np.column_stack([mean, root])[variables]
            own[:, 0] += fixed[i, j]
            entries.append(own)
            places.setdefault(k, []).append(place)
        groups = tuple(np.moveaxis(np.array(group), 0, 2) for _, group in sorted(places.items()))
        every = np.concatenate([np.zeros((0, 1 + len(mean))), *entries])
        return cls(every[:, 0], every[:, 1:], groups)

    def turned(self, Q: Float[np.ndarray, "n n"]) -> "Cones":
        """The same for y = Q·y'."""
        return replace(self, slopes=self.slopes @ Q)

    def hold(self, entries: Entries) -> Bool[np.ndarray, " points"]:
        """Which points lie inside, by the entries of their blocks (Gauss, pivots positive)."""
        inside = np.ones(entries.shape[1], dtype=bool)
        with np.errstate(all="ignore"):  # what follows a pivot of zero does not matter
            for places in self.groups:
                A = entries[places]
                for j in range(len(A)):
                    pivot = A[j, j]
                    inside &= np.all(pivot > 0, axis=0)
                    for i in range(j + 1, len(A)):
                        A[i, j + 1 : i + 1] -= A[i, j] / pivot * A[j + 1 : i + 1, j]
        return inside

    def curvature(self, y: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Second derivative of −Σ log det M_b at a point inside.

        From there, a direction of curvature h meets an edge after some 1/√h.
        """
        entries = self.constant + self.slopes @ y
        H = np.zeros((len(y), len(y)))
        for places in self.groups:
            for block in np.moveaxis(places, 2, 0):
                W = inverse(np.linalg.cholesky(entries[block]).T).T
                flat = np.einsum("ij,jkn,lk->nil", W, self.slopes[block], W).reshape(len(y), -1)
                H += flat @ flat.T
        return H
