"""Which robots belong to a type.

Robot r is left out of the mean; by what the others say its rows are normal about H_r m with the
covariance V = 1 + H_r (S + Λ⁻¹) H_rᵀ, and e = b_r − H_r m is what is left. It is asked whether
eᵀV⁻¹e is too large, and whether too much of it goes along one direction: all torques times a
number, or the entries of one body. Friction, which wears, is left aside: it may be anything.
F-distributions with the degrees of freedom of the part by noise tell the chance of each, and the
least of n chances counts n times, so that a robot is named where chance does as much once in so
many robots.

The robots that mean and spreads come from at first are the half that is most alike, so that those
that do not belong have no say.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, fdtrc

from deltaid.population.coordinates import Coordinates
from deltaid.population.mixed import Mean, Rows, mean
from deltaid.population.spreads import ENOUGH, Spreads, fitted_spreads, prior_spreads

# Variance of what may be anything: a hundred times its own size.
ANYTHING = 1e4
# Rounds of naming at most.
_ROUNDS = 8
# Of so many robots each is left out of the spreads too.
_FEW = 16
# From so many robots on one can be named.
LEAST = ENOUGH + 1
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A robot against the others.

    Attributes:
        e, V: what is left of its rows, and their covariance.
        H: its rows.
        constant: what parameters that are not free do to them.
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
        """eᵀV⁻¹e."""
        return float(self.e @ np.linalg.solve(self.V, self.e))

    def chance(self, distance: float, rank: int) -> float:
        """How often a robot that belongs is as far in so many directions."""
        n = max(rank, 1)
        return float(fdtrc(n, self.freedom, distance / n))

    def along(self, HF: Float[np.ndarray, "rows k"]) -> "Along":
        """What is left goes along some rows so far."""
        solved = np.linalg.solve(self.V, HF)
        M, g = HF.T @ solved, solved.T @ self.e
        size = np.sqrt(np.maximum(np.diag(M), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(M / np.outer(size, size))
        told = values > _ROUNDING
        half = vectors[:, told] / np.sqrt(values[told])
        inverse = half @ half.T / np.outer(size, size)
        c = inverse @ g
        return Along(float(g @ c), int(told.sum()), c, np.sqrt(np.diag(inverse)))


@dataclass(frozen=True, eq=False)
class Along:
    """What of a robot goes along some directions.

    Attributes:
        gain: by how much its distance falls if it is off along them.
        rank: of the directions.
        values, stds: coefficients.
    """

    gain: float
    rank: int
    values: Float[np.ndarray, " k"]
    stds: Float[np.ndarray, " k"]


def left_out(
    rows: Rows,
    k: int,
    found: Mean,
    freedom: tuple[float, float],
    anything: Float[np.ndarray, " u"],
) -> LeftOut:
    """Robot k against the others; what may be anything has that variance.

    Args:
        freedom: of its noise, and of the spreads.
    """
    own = rows.at(slice(k, k + 1))
    information, right = found.information, found.right
    if rows.counts[k]:
        A, c, _ = own.whitened(found.variance)
        information, right = information - A[0].T @ A[0], right - A[0].T @ c[0]
    H, b = rows.H[k], rows.b[k]
    used = np.any(H != 0, axis=1)
    H, b, constant = H[used], b[used], rows.constant[k][used]
    variance = found.variance + rows.extra[k] + anything
    V = np.eye(len(H)) + (H * variance) @ H.T + H @ np.linalg.solve(information, H.T)
    e = b - H @ np.linalg.solve(information, right)
    aside = int(np.sum(np.any(np.abs(H[:, anything > 0]) > _ROUNDING, axis=0)))
    # By Satterthwaite; the share of the noise in V is 1 over the eigenvalues.
    shares = np.sort(1.0 / np.linalg.eigvalsh(V))[aside:]
    if not shares.size:  # all of its rows may be anything
        shares = np.ones(1)
    inverse = float(np.mean(shares**2) / freedom[0] + np.mean((1 - shares) ** 2) / freedom[1])
    return LeftOut(e, V, H, constant, max(len(H) - aside, 0), 1.0 / inverse)


def chance(one: LeftOut, coordinates: Coordinates, m: Float[np.ndarray, " u"]) -> float:
    """How often a robot that belongs is as far from the others as one is."""
    owners = coordinates.owners().values()
    bodies = [one.H[:, at] for at in owners if not coordinates.is_friction[at[0]]]
    found = [one.along(along) for along in (torques(one, coordinates, m)[:, None], *bodies)]
    chances = [one.chance(each.gain, each.rank) for each in found if each.rank]
    chances.append(one.chance(one.distance, one.rows))
    return min(1.0, len(chances) * min(chances))


def torques(
    one: LeftOut, coordinates: Coordinates, m: Float[np.ndarray, " u"]
) -> Float[np.ndarray, " rows"]:
    """What all torques of the type do to a robot's rows."""
    return one.H[:, : coordinates.size] @ m[: coordinates.size] + one.constant


@dataclass(frozen=True, eq=False)
class Sorted:
    """Robots that belong, and what is known of the type from them.

    Attributes:
        rows: with those that count marked.
        spreads, mean: of these.
        chances: how often a robot that belongs is as far from the others as each.
    """

    rows: Rows
    spreads: Spreads
    mean: Mean
    chances: Float[np.ndarray, " robots"]

    def fitted_to(self, rows: Rows, coordinates: Coordinates) -> "Sorted":
        """The same robots, with what is unlike in some of them."""
        spreads = fitted_spreads(rows, coordinates, self.spreads if self.spreads.known else None)
        return replace(self, rows=rows, spreads=spreads, mean=_mean(rows, spreads, coordinates))


def sorted_out(
    rows: Rows,
    coordinates: Coordinates,
    freedom: Float[np.ndarray, " robots"],
    naming: float,
    count: int | None = None,
) -> Sorted:
    """Fit a type to the robots that belong to it.

    Args:
        freedom: of each robot's noise; infinite for what always belongs.
        naming: the share of robots that belong that are named.
        count: of robots, the first ones; what is behind them belongs.
    """
    friction = np.where(coordinates.is_friction, ANYTHING, 0.0)
    spreads = prior_spreads(coordinates)
    count = len(rows.H) if count is None else count
    chances = np.ones(count)
    if count < LEAST:
        spreads = fitted_spreads(rows, coordinates)
        return Sorted(rows, spreads, _mean(rows, spreads, coordinates), chances)
    free = rows.with_extra(rows.extra + friction)
    always = np.arange(len(rows.H)) >= count
    rows = rows.counting(_core(free, coordinates, spreads, count) | always)
    seen = list[bytes]()
    for _ in range(_ROUNDS):
        spreads = fitted_spreads(rows, coordinates, spreads if spreads.known else None)
        found = _mean(rows, spreads, coordinates)
        one = [
            left_out(rows, k, found, (freedom[k], spreads.freedom), friction) for k in range(count)
        ]
        m = found.m
        chances = np.array([chance(each, coordinates, m) for each in one])
        counts = always.copy()
        counts[:count] = _belonging(chances, one, naming, first=not seen)
        if counts.tobytes() in seen or np.array_equal(counts, rows.counts):
            break
        seen.append(counts.tobytes())
        rows = rows.counting(counts)
    if count <= _FEW:
        rows, chances = _one_by_one(rows, coordinates, freedom, naming, count)
        spreads = fitted_spreads(rows, coordinates, spreads)
    return Sorted(rows, spreads, _mean(rows, spreads, coordinates), chances)


def _one_by_one(
    rows: Rows,
    coordinates: Coordinates,
    freedom: Float[np.ndarray, " robots"],
    naming: float,
    count: int,
) -> tuple[Rows, Float[np.ndarray, " robots"]]:
    """The same of few robots, each left out of the spreads as well, which it would widen until it
    seems to belong; the farthest is put aside before the next is looked for."""
    friction = np.where(coordinates.is_friction, ANYTHING, 0.0)
    while True:
        chances = np.ones(count)
        for k in range(count):
            others = rows.counts.copy()
            others[k] = False
            without = rows.counting(others)
            spreads = fitted_spreads(without, coordinates)
            found = _mean(without, spreads, coordinates)
            one = left_out(without, k, found, (freedom[k], spreads.freedom), friction)
            chances[k] = chance(one, coordinates, found.m)
        inside = np.flatnonzero(rows.counts[:count])
        worst = inside[np.argmin(chances[inside])]
        if chances[worst] >= naming or len(inside) < LEAST:
            return rows, chances
        counts = rows.counts.copy()
        counts[worst] = False
        rows = rows.counting(counts)


def _belonging(
    chances: np.ndarray, one: list[LeftOut], naming: float, *, first: bool
) -> np.ndarray:
    """Those that count next. A core's spreads are too small: at first the middle robot is as far as
    it should be."""
    if not first:
        return chances >= naming
    ratio = np.array([each.distance / chdtri(max(each.rows, 1), 0.5) for each in one])
    scale = max(float(np.median(ratio)), 1.0)
    return np.array([each.chance(each.distance / scale, each.rows) >= naming for each in one])


def _core(rows: Rows, coordinates: Coordinates, spreads: Spreads, count: int) -> np.ndarray:
    """The half of the robots that are nearest to a mean that far ones hardly pull."""
    A, c, _ = rows.at(slice(count)).whitened(spreads.variance(coordinates))
    weights, size = np.ones(len(A)), np.sum(np.any(A != 0, axis=2), axis=1)
    distance = np.zeros(len(A))
    for _ in range(50):
        information = coordinates.precision + np.einsum("r,rnu,rnv->uv", weights, A, A)
        right = coordinates.precision @ coordinates.prior + np.einsum("r,rnu,rn->u", weights, A, c)
        left = c - A @ np.linalg.solve(information, right)
        distance = np.sum(left**2, axis=1)
        # Of Student's t with so few degrees of freedom that half of all may be far.
        weights = (1.0 + size) / (1.0 + distance * size / np.median(distance))
    counts = np.zeros(len(rows.H), dtype=bool)
    counts[np.argsort(distance, kind="stable")[: max(ENOUGH, (len(A) + 1) // 2)]] = True
    return counts


def _mean(rows: Rows, spreads: Spreads, coordinates: Coordinates) -> Mean:
    return mean(rows, spreads.variance(coordinates), coordinates.precision, coordinates.prior)
