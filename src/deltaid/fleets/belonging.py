"""Outlier tests: which robots belong to a type.

Robot r is excluded from the mean. Given the others, its rows are normal about H_r m with the
covariance V = 1 + H_r (S + Λ⁻¹) H_rᵀ and the residual e = b_r − H_r m. A robot is an outlier if
eᵀV⁻¹e is too large, or too much of it lies along one direction: a factor of all torques, or the
entries of one body. Friction, which wears, is free. F-distributions with the degrees of freedom of
the noise give the p-values. Bodies come from the same moulds, but a torque constant is entered for
each machine: the test of torques has half of the false-alarm probability, the others share the
rest equally.

Mean and spreads start from the most similar half of the robots, so outliers have no influence.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, fdtrc

from deltaid.estimation.scatter import CHANCE
from deltaid.fleets.coordinates import Coordinates, U
from deltaid.fleets.mixed_model import (
    ENOUGH,
    Mean,
    RobotRows,
    Spreads,
    fitted_spreads,
    mean,
    prior_spreads,
)
from deltaid.levels import NEGLIGIBLE

# Number of robots up to which a tested robot is excluded from the spreads as well.
_FEW = 16
# Least number of robots for outlier tests.
LEAST = ENOUGH + 1


@dataclass(frozen=True, eq=False)
class Along:
    """Part of a robot's residual along some directions.

    Attributes:
        gain: reduction of its squared distance by deviations along them.
        rank: of the directions.
        values, stds: coefficients.
    """

    gain: float
    rank: int
    values: Float[np.ndarray, " k"]
    stds: Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class AgainstOthers:
    """A robot compared with the others.

    Attributes:
        e, V: residual of its rows, and its covariance.
        H: its rows.
        constant: contribution of fixed parameters.
        rows: number of tested rows.
        freedom: degrees of freedom of V.
    """

    e: Float[np.ndarray, " rows"]
    V: Float[np.ndarray, "rows rows"]
    H: Float[np.ndarray, "rows u"]
    constant: Float[np.ndarray, " rows"]
    rows: int
    freedom: float

    @cached_property
    def distance(self) -> float:
        """Squared distance eᵀV⁻¹e of the robot."""
        return float(self.e @ np.linalg.solve(self.V, self.e))

    def chance(self, distance: float, rank: int) -> float:
        """p-value of a squared distance in `rank` directions."""
        n = max(rank, 1)
        return float(fdtrc(n, self.freedom, distance / n))

    def along(self, HF: Float[np.ndarray, "rows k"]) -> Along:
        solved = np.linalg.solve(self.V, HF)
        M = HF.T @ solved
        size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(M / np.outer(size, size))
        used = values > NEGLIGIBLE
        half = vectors[:, used] / np.sqrt(values[used]) / size[:, None]
        g = half.T @ (solved.T @ self.e)
        return Along(float(g @ g), int(used.sum()), half @ g, np.linalg.norm(half, axis=1))


def leave_one_out(
    rows: RobotRows, k: int, mean: Mean, freedom: tuple[float, float], anything: U
) -> AgainstOthers:
    """Robot k compared with the others.

    Args:
        freedom: of its noise, and of the spreads.
        anything: variance of free variables, zero for others.
    """
    information, right = mean.information, mean.right
    if rows.counts[k]:
        (A,), (c,), _ = rows.only(slice(k, k + 1)).whitened(mean.variance)
        information, right = information - A.T @ A, right - A.T @ c
    size = np.linalg.norm(rows.H[k], axis=1)
    used = size > NEGLIGIBLE * size.max(initial=0.0)  # rows beyond a triangle's rank are zero
    H, b, constant = rows.H[k][used], rows.b[k][used], rows.constant[k][used]
    variance = mean.variance + rows.extra[k] + anything
    V = np.eye(len(H)) + (H * variance) @ H.T + H @ np.linalg.solve(information, H.T)
    e = b - H @ np.linalg.solve(information, right)
    aside = int(np.sum(np.any(np.abs(H[:, anything > 0]) > NEGLIGIBLE, axis=0)))
    # Satterthwaite's degrees of freedom; the share of the noise in V is 1 over the eigenvalues.
    shares = np.sort(1.0 / np.linalg.eigvalsh(V))[aside:]
    if not shares.size:  # all of its rows are free
        shares = np.ones(1)
    inverse = float(np.mean(shares**2) / freedom[0] + np.mean((1 - shares) ** 2) / freedom[1])
    return AgainstOthers(e, V, H, constant, max(len(H) - aside, 0), 1.0 / inverse)


def chance(robot: AgainstOthers, coordinates: Coordinates, m: U) -> float:
    """p-value of a robot against the hypothesis that it belongs."""
    owners, is_friction = coordinates.owners().values(), coordinates.is_friction
    bodies = (robot.along(robot.H[:, places]) for places in owners if not is_friction[places[0]])
    chances = [robot.chance(part.gain, part.rank) for part in bodies if part.rank]
    chances.append(robot.chance(robot.distance, robot.rows))
    scale = robot.along(torques(robot, coordinates, m)[:, None])
    return min(1.0, 2 * robot.chance(scale.gain, scale.rank), 2 * len(chances) * min(chances))


def torques(robot: AgainstOthers, coordinates: Coordinates, m: U) -> Float[np.ndarray, " rows"]:
    """A robot's rows for the mean parameters of the type."""
    return robot.H[:, : coordinates.size] @ m[: coordinates.size] + robot.constant


@dataclass(frozen=True, eq=False)
class Sorted:
    """Robots, some of which belong to a type, and the type that these determine.

    Attributes:
        freedom: of each robot's noise.
        rows: of all robots, which mark the ones that belong, then rows that always belong.
        spreads, mean: of robots that belong.
        chances: p-value of each robot.
    """

    coordinates: Coordinates
    freedom: Float[np.ndarray, " robots"]
    rows: RobotRows
    spreads: Spreads
    mean: Mean
    chances: Float[np.ndarray, " robots"]

    @classmethod
    def fitted_to(
        cls,
        coordinates: Coordinates,
        freedom: Float[np.ndarray, " robots"],
        rows: RobotRows,
        start: Spreads | None = None,
    ) -> "Sorted":
        """Spreads and mean of marked rows."""
        spreads = fitted_spreads(rows, coordinates, start)
        return cls(
            coordinates=coordinates,
            freedom=freedom,
            rows=rows,
            spreads=spreads,
            mean=mean(rows, spreads.variance(), coordinates.precision, coordinates.prior),
            chances=np.ones(len(freedom)),
        )

    def with_rows(self, rows: RobotRows) -> "Sorted":
        """Spreads and mean of other rows, with the same p-values."""
        return replace(
            Sorted.fitted_to(self.coordinates, self.freedom, rows, self.spreads),
            chances=self.chances,
        )

    def against_others(self, k: int, anything: U) -> AgainstOthers:
        """Robot k compared with the others, as in `leave_one_out`."""
        return leave_one_out(
            self.rows, k, self.mean, (float(self.freedom[k]), self.spreads.freedom), anything
        )


def fit_members(
    rows: RobotRows, coordinates: Coordinates, freedom: Float[np.ndarray, " robots"]
) -> Sorted:
    """Fit a type to the robots that belong to it.

    Args:
        rows: of robots, then rows that always belong, if any.
        freedom: of each robot's noise.
    """
    count = len(freedom)
    if count < LEAST:
        return Sorted.fitted_to(coordinates, freedom, rows)
    counts, robots = np.arange(len(rows.H)) >= count, range(count)
    counts[:count] = _core(rows.only(slice(count)), coordinates)
    fitted = Sorted.fitted_to(coordinates, freedom, replace(rows, counts=counts))
    visited = list[bytes]()
    while True:  # until a set of robots repeats
        excluded = [fitted.against_others(k, coordinates.free_friction) for k in robots]
        chances = np.array([chance(robot, coordinates, fitted.mean.m) for robot in excluded])
        fitted, counts = replace(fitted, chances=chances), counts.copy()
        counts[:count] = _belonging(chances, excluded, CHANCE, first=not visited)
        if counts.tobytes() in visited or np.array_equal(counts, fitted.rows.counts):
            break
        visited.append(counts.tobytes())
        fitted = fitted.with_rows(replace(rows, counts=counts))
    return _one_by_one(fitted) if count <= _FEW else fitted


def _one_by_one(fitted: Sorted) -> Sorted:
    """Test few robots again, each excluded from the spreads as well, which an outlier would widen
    until it seems to belong; exclude the farthest robot and repeat."""
    coordinates, rows, count = fitted.coordinates, fitted.rows, len(fitted.freedom)
    while True:
        chances = np.ones(count)
        for k in range(count):
            others = replace(rows, counts=rows.counts & (np.arange(len(rows.H)) != k))
            without = Sorted.fitted_to(coordinates, fitted.freedom, others)
            robot = without.against_others(k, coordinates.free_friction)
            chances[k] = chance(robot, coordinates, without.mean.m)
        inside = np.flatnonzero(rows.counts[:count])
        worst = inside[np.argmin(chances[inside])]
        if chances[worst] >= CHANCE or len(inside) < LEAST:
            return replace(fitted, chances=chances).with_rows(rows)
        rows = replace(rows, counts=rows.counts & (np.arange(len(rows.H)) != worst))


def _belonging(
    chances: np.ndarray, robots: Sequence[AgainstOthers], least: float, *, first: bool
) -> np.ndarray:
    """Mark robots for the next fit. The spreads of the core are too small, so distances are first
    scaled to their expected median."""
    if not first:
        return chances >= least
    ratio = [robot.distance / chdtri(max(robot.rows, 1), 0.5) for robot in robots]
    scale = max(float(np.median(ratio)), 1.0)
    return np.array([x.chance(x.distance / scale, x.rows) for x in robots]) >= least


def _core(rows: RobotRows, coordinates: Coordinates) -> np.ndarray:
    """Mark the half of the robots that is nearest to a robust mean."""
    free = replace(rows, extra=rows.extra + coordinates.free_friction)
    A, c, _ = free.whitened(prior_spreads(coordinates).variance())
    weights, size = np.ones(len(A)), np.sum(np.any(A != 0, axis=2), axis=1)
    distance = np.zeros(len(A))
    for _ in range(50):
        weighted = (weights[:, None, None] * A).reshape(-1, A.shape[2])
        information = coordinates.precision + weighted.T @ A.reshape(weighted.shape)
        right = coordinates.precision @ coordinates.prior + weighted.T @ c.ravel()
        distance = np.sum((c - A @ np.linalg.solve(information, right)) ** 2, axis=1)
        # Weights of Student's t with few degrees of freedom: half of all robots may be outliers.
        weights = (1.0 + size) / (1.0 + distance * size / np.median(distance))
    nearest = np.argsort(distance, kind="stable")[: max(ENOUGH, (len(A) + 1) // 2)]
    return np.isin(np.arange(len(A)), nearest)
