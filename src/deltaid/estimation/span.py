"""The span of columns, and least squares in it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

# Singular values of columns of unit length below this share of the largest are zero.
DEPENDENT = 1e-9
# Directions that other columns explain up to this share of their length are dropped.
_EXPLAINED = 1e-3

Columns = Float[np.ndarray, "rows columns"]
Rows = Float[np.ndarray, " rows"]


@dataclass(frozen=True, eq=False)
class Span:
    """The span of columns A = Q S, rank decided by singular values of columns of unit length."""

    Q: Float[np.ndarray, "rows rank"]  # orthonormal columns
    # takes Qᵀb to the x of least squares that is shortest in units of the columns
    inverse: Float[np.ndarray, "columns rank"]

    @classmethod
    @threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
    def of(cls, A: Columns) -> "Span":
        """That of some columns; one that is zero has the coefficient zero."""
        norms = lengths(A)
        Q, R = np.linalg.qr(A / norms)
        U, s, Vt = np.linalg.svd(R, full_matrices=False)
        used = s > DEPENDENT * s.max(initial=0.0)
        return cls(Q @ U[:, used], Vt[used].T / s[used] / norms[:, None])

    @property
    def rank(self) -> int:
        return self.Q.shape[1]

    def without(self, A: np.ndarray) -> np.ndarray:
        """The residual (1 − Q Qᵀ) A."""
        return A - self.Q @ (self.Q.T @ A)

    def coefficients(self, b: Rows) -> Float[np.ndarray, " columns"]:
        """x of least squares for some right side."""
        return self.inverse @ (self.Q.T @ b)

    def with_directions(self, U: Columns) -> "Span":
        """The same with additional orthonormal columns, without coefficients."""
        nothing = np.zeros((len(self.inverse), U.shape[1]))
        return Span(np.hstack([self.Q, U]), np.hstack([self.inverse, nothing]))

    def with_columns(self, A: Columns) -> "Span":
        """The same with additional columns, as far as they are not explained yet."""
        U, s, _ = np.linalg.svd(self.without(A), full_matrices=False)
        return self.with_directions(U[:, s > DEPENDENT * np.linalg.norm(A)])


def lengths(A: Columns) -> Float[np.ndarray, " columns"]:
    """Euclidean norms of columns, 1 for those that are zero."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0, norms, 1.0)


def independent(A: Columns) -> Float[np.ndarray, "columns rank"]:
    """Orthonormal combinations of unit columns that others are projected out of, without directions
    of nearly zero length."""
    values, vectors = np.linalg.eigh(A.T @ A)
    used = values > _EXPLAINED**2
    return vectors[:, used] / np.sqrt(values[used])
