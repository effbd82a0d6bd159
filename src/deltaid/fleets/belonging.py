"""Which robots belong to a type.

Robot r is excluded from the mean; given the others its rows are normal about H_r m with the
covariance V = 1 + H_r (S + Λ⁻¹) H_rᵀ, and the residual is e = b_r − H_r m. Tests are whether eᵀV⁻¹e
is too large, and whether too much of it lies along one direction: all torques times a number, or
the entries of one body. Friction, which wears, may be anything. F-distributions with the degrees of
freedom of the noise give the chance of each. Bodies come from the same moulds, a torque constant
is typed in for each machine: half of the chance to name one that belongs is that of torques, and
the others have equal parts of the rest.

Mean and spreads start from the half of the robots that is most alike, so that outliers have no
influence.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, fdtrc

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

# Rounds of naming at most.
_ROUNDS = 8
# Up to so many robots each is excluded from the spreads too.
_FEW = 16
# From so many robots on one can be named.
LEAST = ENOUGH + 1
# Below this share of the largest a row or an eigenvalue is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Along:
    """Part of a robot's residual along some directions.

    Attributes:
        gain: by how much its distance falls if it is off along them.
        rank: of the directions.
        values, stds: coefficients.
    """

    gain: float
    rank: int
    values: Float[np.ndarray, " k"]
    stds: Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class AgainstOthers:
    """A robot against the others.

    Attributes:
        e, V: residual of its rows, and its covariance.
        H: its rows.
        constant: part of fixed parameters.
        rows: number of its rows that count.
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
        """How often a robot that belongs is as far in so many directions."""
        n = max(rank, 1)
        return float(fdtrc(n, self.freedom, distance / n))

    def along(self, HF: Float[np.ndarray, "rows k"]) -> Along:
        solved = np.linalg.solve(self.V, HF)
        M = HF.T @ solved
        size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(M / np.outer(size, size))
        used = values > _ROUNDING
        half = vectors[:, used] / np.sqrt(values[used]) / size[:, None]
        g = half.T @ (solved.T @ self.e)
        return Along(float(g @ g), int(used.sum()), half @ g, np.linalg.norm(half, axis=1))


def left_out(
    rows: RobotRows, k: int, mean: Mean, freedom: tuple[float, float], anything: U
) -> AgainstOthers:
    """Robot k against the others; what may be anything has that variance.

    Args:
        freedom: of its noise, and of the spreads.
    """
    information, right = mean.information, mean.right
    if rows.counts[k]:
        (A,), (c,), _ = rows.only(slice(k, k + 1)).whitened(mean.variance)
        information, right = information - A.T @ A, right - A.T @ c
    size = np.linalg.norm(rows.H[k], axis=1)
    used = size > _ROUNDING * size.max(initial=0.0)  # rows beyond the rank of a triangle are zero
    H, b, constant = rows.H[k][used], rows.b[k][used], rows.constant[k][used]
    variance = mean.variance + rows.extra[k] + anything
    V = np.eye(len(H)) + (H * variance) @ H.T + H @ np.linalg.solve(information, H.T)
    e = b - H @ np.linalg.solve(information, right)
    aside = int(np.sum(np.any(np.abs(H[:, anything > 0]) > _ROUNDING, axis=0)))
    # By Satterthwaite; the share of the noise in V is 1 over the eigenvalues.
    shares = np.sort(1.0 / np.linalg.eigvalsh(V))[aside:]
    if not shares.size:  # all of its rows may be anything
        shares = np.ones(1)
    inverse = float(np.mean(shares**2) / freedom[0] + np.mean((1 - shares) ** 2) / freedom[1])
    return AgainstOthers(e, V, H, constant, max(len(H) - aside, 0), 1.0 / inverse)


def chance(robot: AgainstOthers, coordinates: Coordinates, m: U) -> float:
    """How often a robot that belongs is as far from the others as this one."""
    owners, is_friction = coordinates.owners().values(), coordinates.is_friction
    bodies = (robot.along(robot.H[:, places]) for places in owners if not is_friction[places[0]])
    chances = [robot.chance(part.gain, part.rank) for part in bodies if part.rank]
    chances.append(robot.chance(robot.distance, robot.rows))
    scale = robot.along(torques(robot, coordinates, m)[:, None])
    return min(1.0, 2 * robot.chance(scale.gain, scale.rank), 2 * len(chances) * min(chances))


def torques(robot: AgainstOthers, coordinates: Coordinates, m: U) -> Float[np.ndarray, " rows"]:
    """A robot's rows for all torques of the type."""
    return robot.H[:, : coordinates.size] @ m[: coordinates.size] + robot.constant


@dataclass(frozen=True, eq=False)
class Sorted:
    """Robots of which some belong to a type, and the type by these.

    Attributes:
        freedom: of each robot's noise.
        rows: with those that belong marked; behind the robots' what belongs always.
        spreads, mean: of those that belong.
        chances: how often a robot that belongs is as far from the others as each.
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
        """Spreads and mean of rows that are marked."""
        spreads = fitted_spreads(rows, coordinates, start)
        type_mean = mean(rows, spreads.variance(), coordinates.precision, coordinates.prior)
        return cls(coordinates, freedom, rows, spreads, type_mean, np.ones(len(freedom)))

    def with_rows(self, rows: RobotRows) -> "Sorted":
        """The same chances, with spreads and mean of other rows."""
        fitted = Sorted.fitted_to(self.coordinates, self.freedom, rows, self.spreads)
        return replace(fitted, chances=self.chances)

    def against_others(self, k: int, anything: U) -> AgainstOthers:
        """Robot k, as of `left_out`."""
        freedom = (float(self.freedom[k]), self.spreads.freedom)
        return left_out(self.rows, k, self.mean, freedom, anything)


def sorted_out(
    rows: RobotRows, coordinates: Coordinates, freedom: Float[np.ndarray, " robots"], naming: float
) -> Sorted:
    """Fit a type to the robots that belong to it.

    Args:
        rows: of robots, and perhaps of what always belongs behind them.
        freedom: of each robot's noise.
        naming: the share of robots that belong that are named.
    """
    count = len(freedom)
    if count < LEAST:
        return Sorted.fitted_to(coordinates, freedom, rows)
    counts, robots = np.arange(len(rows.H)) >= count, range(count)
    counts[:count] = _core(rows.only(slice(count)), coordinates)
    fitted = Sorted.fitted_to(coordinates, freedom, replace(rows, counts=counts))
    visited = list[bytes]()
    for _ in range(_ROUNDS):
        excluded = [fitted.against_others(k, coordinates.worn) for k in robots]
        chances = np.array([chance(robot, coordinates, fitted.mean.m) for robot in excluded])
        fitted, counts = replace(fitted, chances=chances), counts.copy()
        counts[:count] = _belonging(chances, excluded, naming, first=not visited)
        if counts.tobytes() in visited or np.array_equal(counts, fitted.rows.counts):
            break
        visited.append(counts.tobytes())
        fitted = fitted.with_rows(replace(rows, counts=counts))
    return _one_by_one(fitted, naming) if count <= _FEW else fitted


def _one_by_one(fitted: Sorted, naming: float) -> Sorted:
    """The same for few robots, each excluded from the spreads as well, which it would widen until
    it seems to belong; the farthest is excluded before the next search."""
    coordinates, rows, count = fitted.coordinates, fitted.rows, len(fitted.freedom)
    while True:
        chances = np.ones(count)
        for k in range(count):
            others = replace(rows, counts=rows.counts & (np.arange(len(rows.H)) != k))
            without = Sorted.fitted_to(coordinates, fitted.freedom, others)
            robot = without.against_others(k, coordinates.worn)
            chances[k] = chance(robot, coordinates, without.mean.m)
        inside = np.flatnonzero(rows.counts[:count])
        worst = inside[np.argmin(chances[inside])]
        if chances[worst] >= naming or len(inside) < LEAST:
            return replace(fitted, chances=chances).with_rows(rows)
        rows = replace(rows, counts=rows.counts & (np.arange(len(rows.H)) != worst))


def _belonging(
    chances: np.ndarray, robots: Sequence[AgainstOthers], naming: float, *, first: bool
) -> np.ndarray:
    """Those that count next. A core's spreads are too small: at first the middle robot is as far as
    it should be."""
    if not first:
        return chances >= naming
    ratio = [robot.distance / chdtri(max(robot.rows, 1), 0.5) for robot in robots]
    scale = max(float(np.median(ratio)), 1.0)
    return np.array([x.chance(x.distance / scale, x.rows) for x in robots]) >= naming


def _core(rows: RobotRows, coordinates: Coordinates) -> np.ndarray:
    """The half of the robots that are nearest to a mean that far ones hardly pull."""
    free = replace(rows, extra=rows.extra + coordinates.worn)
    A, c, _ = free.whitened(prior_spreads(coordinates).variance())
    weights, size = np.ones(len(A)), np.sum(np.any(A != 0, axis=2), axis=1)
    distance = np.zeros(len(A))
    for _ in range(50):
        weighted = (weights[:, None, None] * A).reshape(-1, A.shape[2])
        information = coordinates.precision + weighted.T @ A.reshape(weighted.shape)
        right = coordinates.precision @ coordinates.prior + weighted.T @ c.ravel()
        distance = np.sum((c - A @ np.linalg.solve(information, right)) ** 2, axis=1)
        # Of Student's t with so few degrees of freedom that half of all may be far.
        weights = (1.0 + size) / (1.0 + distance * size / np.median(distance))
    nearest = np.argsort(distance, kind="stable")[: max(ENOUGH, (len(A) + 1) // 2)]
    return np.isin(np.arange(len(A)), nearest)
