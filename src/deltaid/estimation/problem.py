"""A linear least-squares problem: columns, weighted rows in groups, a prior.

    A x = b + e,    D x = d + e₀,    Var e₀ = 1

Rows are in groups g, stretches of time, and those of the prior in none. x is the minimiser
of ‖A x − b‖² + ‖D x − d‖² or, where columns share noise with b, that of ‖Qᵀ(A x − b)‖² + … with Q
an orthonormal basis of instruments Z, columns without that noise. It errs by Σ_g s_g with the
scores s_g = K_gᵀ e_g, K the rows' influence on x. Torques are not white, so the scatter of s_g
gives the covariance, or white noise of the same size where that is more (Liang and Zeger 1986).

Groups of columns with priors of their own and blocks of rows of one noise level are what a shrunk
fit is posed from (`shrinkage`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from deltaid.levels import FAINT, HARDLY, NEGLIGIBLE

# The group of the prior's rows.
KNOWN = -1
# Rows whose sums show noise that is not white, and by how much it may exceed white noise.
_SLOW, _REDDEST = 8, 30.0

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
    def of_columns(cls, A: Columns) -> "Span":
        """That of some columns; one that is zero has the coefficient zero."""
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
        """x of least squares for some right side."""
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
    """Orthonormal combinations of unit columns that others are projected out of, without directions
    of nearly zero length."""
    values, vectors = np.linalg.eigh(A.T @ A)
    used = values > HARDLY**2
    return vectors[:, used] / np.sqrt(values[used])


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """Rows A x = b, each divided by the standard deviation of its noise."""

    A: Columns  # A, b: columns and right side
    b: Rows
    # of each row; `KNOWN` for the prior, whose noise is 1
    groups: Int[np.ndarray, " rows"]
    # instruments; the columns themselves where they have no noise
    Z: Float[np.ndarray, "rows instruments"] | None = None
    # how many measured values the rows of groups stand for, where these have been condensed
    values: float | None = None

    @classmethod
    def of_triangle(cls, R: Columns, values: float) -> "LinearProblem":
        """Rows of so many values, condensed to R with RᵀR = [A b]ᵀ[A b], in one group."""
        return cls(R[:, :-1], R[:, -1], np.zeros(len(R), dtype=int), values=values)

    @classmethod
    def together(cls, problems: Sequence["LinearProblem"]) -> "LinearProblem":
        """All rows of problems over the same columns, with groups of their own."""
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
        """Takes Qᵀb to x."""
        if self.Z is None:
            return self.span.inverse
        norms = lengths(self.A)
        return np.linalg.pinv(self.span.Q.T @ (self.A / norms), rcond=NEGLIGIBLE) / norms[:, None]

    @cached_property
    def x(self) -> Float[np.ndarray, " columns"]:
        """The minimiser; of several the shortest in units of the columns."""
        return self.inverse @ (self.span.Q.T @ self.b)

    @cached_property
    def residual(self) -> Rows:
        return self.b - self.A @ self.x

    @property
    def noise(self) -> float:
        """Standard deviation of white noise that would leave the residual."""
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

    @property
    def triangle(self) -> Columns:
        """The triangle R of [A b], RᵀR = [A b]ᵀ[A b]."""
        return np.asarray(np.linalg.qr(np.column_stack([self.A, self.b]), mode="r"))

    def covariance(self, entries: slice = slice(None)) -> Float[np.ndarray, "columns columns"]:
        """Of some entries of x, by the scatter between groups and the prior."""
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
    """What orthonormal columns explain of rows, beside others.

    Attributes:
        gain: the sum of squares, of which chance explains `level` with each column: the variance of
            the noise along them by its scatter between groups, or white if that is larger.
        left: what remains.
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
        """By columns U beside others of some rank, without which they and the residual are."""
        scores = U.T @ residual
        left, freedom = residual - U @ scores, max(len(residual) - rank - U.shape[1], 1)
        s = group_sums(U * left[:, None], groups)
        along = float(np.sum(s**2)) / U.shape[1] * (len(s) / max(len(s) - 1, 1))
        level = max(along, float(left @ left) / freedom, 1e-300)
        return cls(U, float(scores @ scores), left, level)


@dataclass(frozen=True, eq=False)
class CauseColumns:
    """Columns that one cause has.

    Attributes:
        deviation: prior standard deviation of each coefficient.
        mean: of the prior, minus what has been applied already.
        is_candidate: whether it is corrected; else it only keeps others from explaining it.
        may_be_dropped: whether a candidate goes where rows do not need it.
        is_positive: whether x less the mean, all that is applied, is at least zero by physics.
        is_possible: whether physics allows such values of x less the mean, with this covariance; a
            candidate whose estimate it does not allow stands for something else, and is dropped.
    """

    name: str
    columns: Int[np.ndarray, " k"]
    deviation: Float[np.ndarray, " k"]
    mean: Float[np.ndarray, " k"]
    is_candidate: bool = True
    is_positive: bool = False
    may_be_dropped: bool = True
    is_possible: Callable[[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]], bool] = lambda *_: (
        True
    )

    def allows(self, x: Float[np.ndarray, " n"], covariance: Float[np.ndarray, "n n"]) -> bool:
        """Whether physics allows all that is applied.

        Slopes are known where coefficients were before: a step of x is off by as much as itself, or
        effects that bend would go before they have settled.
        """
        step = x[self.columns]
        own = covariance[np.ix_(self.columns, self.columns)] + np.outer(step, step)
        return self.is_possible(step - self.mean, own)

    def held(self, x: Float[np.ndarray, " n"]) -> "CauseColumns":
        """With coefficients at zero where physics allows no less than x has."""
        below = self.is_positive & (x[self.columns] < self.mean)
        return replace(self, deviation=np.where(below, FAINT * self.deviation, self.deviation))


@dataclass(frozen=True, eq=False)
class NoiseBlock:
    """Rows A x = b of one noise level.

    Attributes:
        stretches: of time, of each row.
        largest: the largest measured value beside them.
        independent: share of the rows whose noise is independent, behind a low-pass.
    """

    A: Columns
    b: Rows
    stretches: Int[np.ndarray, " rows"]
    largest: float
    independent: float = 1.0

    @cached_property
    def normal(self) -> Float[np.ndarray, "n n"]:
        return self.A.T @ self.A

    @cached_property
    def right(self) -> Float[np.ndarray, " n"]:
        return self.A.T @ self.b

    def noise(self, residual: Rows) -> float:
        """Standard deviation of its noise; slow errors of the model count as noise."""
        count = len(residual) // _SLOW * _SLOW
        variance = float(np.mean(residual**2))
        slow = np.mean(residual[:count].reshape(-1, _SLOW).sum(axis=1) ** 2) / _SLOW
        red = np.clip(slow / max(variance, 1e-300), 1.0, _REDDEST)
        return float(np.sqrt(max(variance * red, 1e-300)))
