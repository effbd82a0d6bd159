"""Mixed model of a type: u_r = μ + δ_r, δ_r ~ N(0, S), rows H_r u_r = b_r with unit noise.

With V_r = 1 + H_r S H_rᵀ and its Cholesky factor L_r, A_r = L_r⁻¹H_r and c_r = L_r⁻¹b_r have unit
noise about the mean, so that

    Λ = P + Σ A_rᵀA_r,    Λ m = P u_prior + Σ A_rᵀ c_r

are precision and mean of μ, with P the precision of the description. Given all robots, δ_r is
normal about S A_rᵀ(c_r − A_r m) with covariance S − S A_rᵀA_r S + T Λ⁻¹ Tᵀ, T = S A_rᵀA_r. The
marginal likelihood of S, with μ integrated out (REML), has by Fisher's identity the slope

    ∂ log L / ∂ log s_k = Σ_r Σ_j∈k (E δ_rj² / s_k² − 1).

Robots are processed in parts, so memory does not grow with their number.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import inv
from scipy.optimize import minimize

from deltaid.estimation.information import triangle
from deltaid.estimation.scatter import NORMAL, inverse
from deltaid.fleets.coordinates import KINDS, VAGUE, Coordinates, Square, U
from deltaid.robot.parameter import PRIOR_SPREAD

# Number of robots processed at once, which bounds memory.
_AT_ONCE = 512
# Bounds of the search for spreads, as shares.
_LEAST, _MOST = 1e-4, 2.0
# Step of log s for the curvature by central differences.
_STEP = np.finfo(float).eps ** (1 / 3)
# Loss of log likelihood without a spread that makes it significant (95 %).
_SIGNIFICANT = 0.5 * NORMAL**2
# Least number of robots that determine spreads.
ENOUGH = 3
# Draws of the spreads, in pairs.
_DRAWS = 16


@dataclass(frozen=True, eq=False)
class RobotRows:
    """Rows of all robots, padded with zeros.

    Attributes:
        H, b: of each robot.
        constant: part of fixed parameters in its rows.
        extra: additional variance of δ for a robot with a known deviation.
        counts: whether a robot belongs to the type.
    """

    H: Float[np.ndarray, "robots rows u"]
    b: Float[np.ndarray, "robots rows"]
    constant: Float[np.ndarray, "robots rows"]
    extra: Float[np.ndarray, "robots u"]
    counts: np.ndarray

    @classmethod
    def stacked(cls, blocks: Sequence[Float[np.ndarray, "_ augmented"]]) -> "RobotRows":
        """Rows of robots that all belong: over u, over p_0, and values."""
        wide = np.zeros((len(blocks), max(len(block) for block in blocks), blocks[0].shape[1]))
        for k, block in enumerate(blocks):
            wide[k, : len(block)] = block
        H, constant, b = wide[:, :, :-2], wide[:, :, -2], wide[:, :, -1]
        return cls(H, b, constant, np.zeros(H.shape[::2]), np.ones(len(blocks), dtype=bool))

    def only(self, robots: slice) -> "RobotRows":
        return RobotRows(*(getattr(self, field.name)[robots] for field in fields(self)))

    def parts(self) -> "Iterator[tuple[slice, RobotRows]]":
        for first in range(0, len(self.H), _AT_ONCE):
            robots = slice(first, first + _AT_ONCE)
            yield robots, self.only(robots)

    def whitened(self, variance: U) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, c and log |V| for variances S."""
        V = (self.H * (variance + self.extra)[:, None, :]) @ np.swapaxes(self.H, 1, 2)
        diagonal = np.arange(V.shape[1])
        V[:, diagonal, diagonal] += 1.0
        L = np.linalg.cholesky(V)
        solved = np.linalg.solve(L, np.concatenate([self.H, self.b[:, :, None]], axis=2))
        log_det = 2 * np.log(L[:, diagonal, diagonal]).sum(axis=1)
        return solved[:, :, :-1], solved[:, :, -1], log_det


@dataclass(frozen=True, eq=False)
class Mean:
    """The type's mean for some spreads.

    Attributes:
        variance: S.
        information, right: Λ and Λ m.
        evidence: log L up to a constant.
    """

    variance: U
    information: Square
    right: U
    evidence: float

    @property
    def covariance(self) -> Square:
        """Covariance Λ⁻¹ of the mean."""
        half = inverse(np.linalg.cholesky(self.information).T)
        return half @ half.T

    @property
    def m(self) -> U:
        return np.linalg.solve(self.information, self.right)


def mean(rows: RobotRows, variance: U, precision: Square, prior: U) -> Mean:
    information, right = precision.copy(), precision @ prior
    evidence = -0.5 * float(prior @ right)
    for _, part in rows.parts():
        A, c, logs = (array[part.counts] for array in part.whitened(variance))
        flat = A.reshape(-1, A.shape[2])
        information += flat.T @ flat
        right += flat.T @ c.ravel()
        evidence -= 0.5 * float(np.sum(c**2) + logs.sum())
    L = np.linalg.cholesky(information)
    evidence += 0.5 * float(np.sum(np.linalg.solve(L, right) ** 2)) - np.log(np.diag(L)).sum()
    return Mean(variance, information, right, float(evidence))


def slope(rows: RobotRows, mean: Mean, kinds: Int[np.ndarray, " u"]) -> Float[np.ndarray, " kinds"]:
    """∂ log L / ∂ log s of every kind."""
    s, m, covariance = mean.variance, mean.m, mean.covariance
    gained = np.zeros(len(s))
    for _, part in rows.parts():
        A, c, _ = part.whitened(s)
        AA = np.swapaxes(A, 1, 2) @ A
        # E δ² / s² − 1 over s
        share = np.einsum("rnu,rn->ru", A, c - A @ m) ** 2 - np.einsum("ruu->ru", AA)
        share += np.einsum("ruv,ruv->ru", AA @ covariance, AA)
        gained += s * np.sum(share * (part.counts[:, None] & (part.extra == 0)), axis=0)
    return np.array([gained[kinds == k].sum() for k in range(kinds.max() + 1)])


def within(rows: RobotRows, mean: Mean) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """u of robots given all of them, and its covariance, for some robots at a time.

    Given the mean, u is normal about m + S Aᵀ(c − A m).
    """
    m, covariance, identity = mean.m, mean.covariance, np.eye(len(mean.right))
    for robots, part in rows.parts():
        variance = mean.variance + part.extra
        A, c, _ = part.whitened(mean.variance)
        SA = variance[:, :, None] * np.swapaxes(A, 1, 2)
        B = identity - SA @ A
        C = variance[:, :, None] * identity - SA @ np.swapaxes(SA, 1, 2)
        C += B @ covariance @ np.swapaxes(B, 1, 2)
        yield robots, m + variance * np.einsum("rnu,rn->ru", A, c - A @ m), C


def alone(rows: RobotRows, precision: Square, prior: U) -> Iterator[tuple[U, Square]]:
    """u of each robot and its covariance from its own rows and the description."""
    n, root = len(prior), np.linalg.cholesky(precision).T
    described = np.column_stack([root, root @ prior])[None]
    for _, part in rows.parts():
        data = np.concatenate([part.H, part.b[:, :, None]], axis=2)
        R = triangle(np.hstack([np.repeat(described, len(data), axis=0), data]))
        half = inv(R[:, :n, :n], assume_a="upper triangular")
        u = np.einsum("ruv,rv->ru", half, R[:, :n, n])
        yield from zip(u, half @ np.swapaxes(half, 1, 2), strict=True)


@dataclass(frozen=True, eq=False)
class Spreads:
    """Standard deviations between robots, as shares of the sizes of entries.

    Attributes:
        kinds: of entries with a spread.
        at: index of the kind of each entry of u; −1 without a spread.
        log: logarithms of the most likely spreads.
        covariance: of these logarithms.
        known: whether the robots are enough to determine them.
        significant: kinds whose spread is significant.
    """

    kinds: tuple[str, ...]
    at: Int[np.ndarray, " u"]
    log: Float[np.ndarray, " kinds"]
    covariance: Float[np.ndarray, "kinds kinds"]
    known: bool
    significant: np.ndarray

    @property
    def freedom(self) -> float:
        """Degrees of freedom of a spread's square: its logarithm has the variance 1 / 2ν."""
        return float(0.5 / np.mean(np.diag(self.covariance)))

    def variance(self, log: np.ndarray | None = None) -> U:
        return np.where(self.at >= 0, np.exp(2 * (self.log if log is None else log))[self.at], 0.0)

    def draws(self) -> list[Float[np.ndarray, " kinds"]]:
        """Random logarithms of spreads, in pairs about the most likely."""
        z = np.random.default_rng(0).standard_normal((_DRAWS // 2, len(self.log)))
        steps = z @ np.linalg.cholesky(self.covariance).T
        return [self.log + sign * step for step in steps for sign in (1.0, -1.0)]

    def of_unknown_sizes(self, covariance: Square) -> "Spreads":
        """Spreads with the uncertainty of the sizes that they are relative to.

        An error of one size enters a kind's spread divided by its number of entries. No size is
        less certain than its prior.

        Args:
            covariance: of the sizes.
        """
        off = np.minimum(np.diag(covariance), PRIOR_SPREAD**2)
        parts = (off[self.at == k] for k in range(len(self.kinds)))
        added = np.diag([part.mean() / len(part) for part in parts])
        return replace(self, covariance=self.covariance + added)

    def of_parameters(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Spread of each of T u between robots, with its interval; NaN if undetermined.

        The lower end is zero where the spread is not significant.
        """
        nothing = np.full(len(T), np.nan)
        if not self.known:
            return nothing, nothing, nothing
        members = self.at[:, None] == np.arange(len(self.kinds))
        parts = T**2 @ (members * self.variance()[:, None])
        total = parts.sum(axis=1)
        shares = parts / np.where(total > 0, total, 1.0)[:, None]
        deviation = np.sqrt(np.einsum("pk,kl,pl->p", shares, self.covariance, shares))
        spread = np.sqrt(total)
        low = spread * np.exp(-NORMAL * deviation) * (shares @ self.significant > 0.5)
        return spread, low, spread * np.exp(NORMAL * deviation)


def prior_spreads(coordinates: Coordinates) -> Spreads:
    kinds, at = coordinates.present, coordinates.kind_of()
    log, n = np.log([KINDS[kind] for kind in kinds]), len(kinds)
    return Spreads(kinds, at, log, VAGUE**2 * np.eye(n), False, np.zeros(n, dtype=bool))


def fitted_spreads(
    rows: RobotRows, coordinates: Coordinates, start: Spreads | None = None
) -> Spreads:
    """The most likely spreads of the robots that belong."""
    before = prior_spreads(coordinates)
    if rows.counts.sum() < ENOUGH:
        return before

    def type_mean(log: np.ndarray) -> Mean:
        return mean(rows, before.variance(log), coordinates.precision, coordinates.prior)

    def falling(log: np.ndarray) -> tuple[float, np.ndarray]:
        """Negative log posterior, and its gradient."""
        fitted, away = type_mean(log), (log - before.log) / VAGUE
        gained = slope(rows, fitted, before.at) - away / VAGUE
        return 0.5 * float(away @ away) - fitted.evidence, -gained

    first = (start or before).log
    bounds = [(np.log(_LEAST), np.log(_MOST))] * len(first)
    done = minimize(falling, first, jac=True, method="L-BFGS-B", bounds=bounds,
                    options={"maxiter": 60, "ftol": 1e-9})  # fmt: skip
    log = np.asarray(done.x)
    steps, top = np.eye(len(log)), type_mean(log).evidence
    H = np.array([falling(log + _STEP * e)[1] - falling(log - _STEP * e)[1] for e in steps])
    none = [np.where(e > 0, np.log(_LEAST), log) for e in steps]
    significant = np.array([top - type_mean(without).evidence > _SIGNIFICANT for without in none])
    values, vectors = np.linalg.eigh((H + H.T) / (4 * _STEP))
    values = np.maximum(values, VAGUE**-2)
    covariance = (vectors / values) @ vectors.T
    return replace(before, log=log, covariance=covariance, known=True, significant=significant)
