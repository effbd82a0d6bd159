"""A linear least-squares problem: columns, weighted rows in groups, a prior.

    A x = b + e,    D x = d + e₀,    Var e₀ = 1

Rows belong to groups g, stretches of time; those of the prior to none. x minimises
‖A x − b‖² + ‖D x − d‖² or, where columns share noise with b, ‖Qᵀ(A x − b)‖² + … with an orthonormal
basis Q of instruments Z, columns without that noise. Its error is Σ_g s_g with the scores
s_g = K_gᵀ e_g and the rows' influence K on x. Noise of torques is not white, so the covariance is
that by the scatter of s_g, or by white noise if this is larger (Liang and Zeger 1986)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from deltaid.levels import HARDLY, NEGLIGIBLE

# Group number of the prior's rows.
KNOWN = -1

Columns = Float[np.ndarray, "rows columns"]
Rows = Float[np.ndarray, " rows"]


@dataclass(frozen=True, eq=False)
class Span:
    """The span of columns; its rank is by singular values of the columns at unit length."""

    Q: Float[np.ndarray, "rows rank"]  # orthonormal basis
    # maps Qᵀb to the least-squares x of least norm in units of the columns
    inverse: Float[np.ndarray, "columns rank"]

    @classmethod
    @threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
    def of_columns(cls, A: Columns) -> "Span":
        """The span of columns A; zero columns have the coefficient zero."""
        norms = lengths(A)
        Q, R = np.linalg.qr(A / norms)
        U, s, Vt = np.linalg.svd(R, full_matrices=False)
        used = s > NEGLIGIBLE * s.max(initial=0.0)
        return cls(Q @ U[:, used], Vt[used].T / s[used] / norms[:, None])

    @property
    def rank(self) -> int:
        return self.Q.shape[1]

    def without(self, A: np.ndarray) -> np.ndarray:
        """The residual (1 − Q Qᵀ) A."""
        return A - self.Q @ (self.Q.T @ A)

    def coefficients(self, b: Rows) -> Float[np.ndarray, " columns"]:
        """x of least squares for a right side."""
        return self.inverse @ (self.Q.T @ b)

    def with_directions(self, U: Columns) -> "Span":
        """The same with additional orthonormal columns, without coefficients."""
        nothing = np.zeros((len(self.inverse), U.shape[1]))
        return Span(np.hstack([self.Q, U]), np.hstack([self.inverse, nothing]))

    def with_columns(self, A: Columns) -> "Span":
        """The same with additional columns, as far as they are not explained yet."""
        U, s, _ = np.linalg.svd(self.without(A), full_matrices=False)
        return self.with_directions(U[:, s > NEGLIGIBLE * np.linalg.norm(A)])


def lengths(A: Columns) -> Float[np.ndarray, " columns"]:
    """Euclidean norms of columns, 1 for those that are zero."""
    norms = np.linalg.norm(A, axis=0)
    return np.where(norms > 0, norms, 1.0)


def independent(A: Columns) -> Float[np.ndarray, "columns rank"]:
    """Combinations V for which A V is orthonormal, for unit columns less their part in a span;
    directions that are nearly in that span are dropped."""
    values, vectors = np.linalg.eigh(A.T @ A)
    used = values > HARDLY**2
    return vectors[:, used] / np.sqrt(values[used])


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """Rows A x = b, each divided by the standard deviation of its noise."""

    A: Columns
    b: Rows
    groups: Int[np.ndarray, " rows"]  # of each row; `KNOWN` for the prior, whose noise is 1
    # instruments; None where the columns have no noise
    Z: Float[np.ndarray, "rows instruments"] | None = None
    values: float | None = None  # number of measured values in condensed rows

    @classmethod
    def of_triangle(cls, R: Columns, values: float) -> "LinearProblem":
        """Rows of so many measured values in one group, condensed to R with RᵀR = [A b]ᵀ[A b]."""
        return cls(R[:, :-1], R[:, -1], np.zeros(len(R), dtype=int), values=values)

    @classmethod
    def together(cls, problems: Sequence["LinearProblem"]) -> "LinearProblem":
        """All rows of problems over the same columns; their groups stay separate."""
        groups, first = [], 0
        for part in problems:
            groups.append(np.where(part.groups == KNOWN, KNOWN, part.groups + first))
            first += int(part.groups.max(initial=KNOWN)) + 1
        instruments = [part.Z for part in problems if part.Z is not None]
        return cls(
            np.vstack([part.A for part in problems]),
            np.concatenate([part.b for part in problems]),
            np.concatenate(groups),
            np.vstack(instruments) if instruments else None,
            sum(part.measured for part in problems),
        )

    def with_known(self, D: Columns, d: Rows) -> "LinearProblem":
        """The same with a prior, which is an instrument for itself."""
        instruments = self.Z
        if instruments is not None:
            padded = np.pad(D, ((0, 0), (0, instruments.shape[1] - D.shape[1])))
            instruments = np.vstack([instruments, padded])
        A, b = np.vstack([self.A, D]), np.append(self.b, d)
        groups = np.append(self.groups, np.full(len(d), KNOWN))
        return replace(self, A=A, b=b, groups=groups, Z=instruments)

    @property
    def measured(self) -> float:
        return float((self.groups != KNOWN).sum()) if self.values is None else self.values

    @cached_property
    def span(self) -> Span:
        """Of instruments, or of the columns."""
        return Span.of_columns(self.A if self.Z is None else self.Z)

    @cached_property
    def inverse(self) -> Float[np.ndarray, "columns rank"]:
        """Maps Qᵀb to x."""
        if self.Z is None:
            return self.span.inverse
        norms = lengths(self.A)
        return np.linalg.pinv(self.span.Q.T @ (self.A / norms), rcond=NEGLIGIBLE) / norms[:, None]

    @cached_property
    def x(self) -> Float[np.ndarray, " columns"]:
        """The minimiser; of several, that of least norm in units of the columns."""
        return self.inverse @ (self.span.Q.T @ self.b)

    @cached_property
    def residual(self) -> Rows:
        return self.b - self.A @ self.x

    @property
    def noise(self) -> float:
        """Standard deviation of white noise by the residual."""
        return float(np.linalg.norm(self.residual) / np.sqrt(self.freedom))

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the white noise level."""
        return max(self.measured - self.span.rank, 1.0)

    @cached_property
    def root(self) -> Float[np.ndarray, "columns columns"]:
        """The triangle R with RᵀR = AᵀA, of independent columns."""
        norms = lengths(self.A)
        return np.asarray(np.linalg.qr(self.A / norms, mode="r")) * norms

    def substituted(
        self, A: Float[np.ndarray, "columns own"], x_0: Float[np.ndarray, " columns"]
    ) -> "LinearProblem":
        """The same over y, for x = A y + x_0."""
        return replace(self, A=self.A @ A, b=self.b - self.A @ x_0)

    def covariance(self, entries: slice = slice(None)) -> Float[np.ndarray, "columns columns"]:
        """Covariance of entries of x, by the scatter between groups and the prior."""
        influence = self.span.Q @ self.inverse[entries].T
        rows = self.groups != KNOWN
        prior = influence[~rows]
        errors = scatter(influence[rows], self.residual[rows], self.groups[rows], self.freedom)
        return errors + prior.T @ prior


def scatter(
    influence: Columns, residual: Rows, groups: Int[np.ndarray, " rows"], freedom: float
) -> Float[np.ndarray, "columns columns"]:
    """Covariance of Σ K_gᵀ e_g by the scatter of its terms, or white if that is wider, with K the
    influence of rows, e their residual and `freedom` of `LinearProblem`."""
    s = group_sums(influence * residual[:, None], groups)
    covariance = s.T @ s * (len(s) / max(len(s) - 1, 1))
    white = np.sum(influence**2, axis=0) * float(residual @ residual) / freedom
    grown = np.sqrt(np.maximum(white / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return covariance * np.outer(grown, grown)


def group_sums(
    rows: Columns, groups: Int[np.ndarray, " rows"]
) -> Float[np.ndarray, "groups columns"]:
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=KNOWN - 1))
    return np.add.reduceat(rows[order], starts, axis=0)


@dataclass(frozen=True, eq=False)
class Explanation:
    """What orthonormal columns explain of rows in addition to others.

    Attributes:
        gain: explained sum of squares.
        left: the remaining rows.
        level: sum of squares that one column explains by chance: the noise along the columns by
            scatter between groups, or white noise if larger.
    """

    directions: Columns
    gain: float
    left: Rows
    level: float

    @property
    def rank(self) -> int:
        return self.directions.shape[1]

    @classmethod
    def by_columns(
        cls, U: Columns, residual: Rows, groups: Int[np.ndarray, " rows"], rank: int
    ) -> "Explanation":
        """By columns U in addition to others of this rank, whose part U and the residual lack."""
        scores = U.T @ residual
        left, freedom = residual - U @ scores, max(len(residual) - rank - U.shape[1], 1)
        s = group_sums(U * left[:, None], groups)
        along = float(np.sum(s**2)) / U.shape[1] * (len(s) / max(len(s) - 1, 1))
        level = max(along, float(left @ left) / freedom, 1e-300)
        return cls(U, float(scores @ scores), left, level)
