"""How likely orders, signs and gains of torque columns are under one map of the positions.

Torques of a robot near its prior are normal: with p ~ N(p₀, α² S²), offsets o of the drives and
white noise, E u = Y p + X o + e, so that every assignment u of torque columns to drives has a
closed evidence. It compares all of them at once. What decides is the fit of a consistent robot,

    −2 log L = N log σ² + ‖W(E u − Y p)‖²/σ² + d²(p, p₀),   p in its cones,

with the entropic distance d² to the prior: a wrong sign explains a poor motion by masses that no
body has. Rows W are shares of each drive's recorded torque, so that units do not decide.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import permutations, product

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.objective import Objective
from deltaid.estimation.posing import METRICS
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.estimation.regularizer import Quadratic, Regularizer

# No model leaves less of a machine's torques than this share, and a drive's torque sensor is off by
# about this share of its torques.
_LEAST, _OFFSET = 0.003, 0.1
# Parameters are off their prior by about so much of themselves, as a median and the spread of its
# logarithm, bodies by about a factor e; steps of α²/σ² that are tried.
_SPREAD, _FACTOR, _GAMMA, _RATIOS = 0.7, 1.0, 1.0, np.geomspace(1e-2, 1e8, 41)
# Torques are scaled to those of the prior where they are so far from them: in another unit.
_UNIT = 2.5
# Rounds of fit and noise level, and change of the latter that ends them.
_ROUNDS, _SETTLED = 4, 0.05
_SOLVER = Conic(tolerance=1e-7, largest_gap=1e-2)

Rows = Float[np.ndarray, " rows"]


@dataclass(frozen=True, eq=False)
class Patterns:
    """Orders and signs of torque columns: all there are, in a fixed sequence.

    Attributes:
        orders, signs: (patterns, drives).
        weights: (patterns, pairs), of the columns of E by drive and torque column.
    """

    orders: Int[np.ndarray, "patterns drives"]
    signs: Float[np.ndarray, "patterns drives"]
    weights: Float[np.ndarray, "patterns pairs"]

    @classmethod
    @lru_cache
    def all_of(cls, dof: int) -> "Patterns":
        """n! orders with 2ⁿ signs each, the first one as mapped."""
        pairs = list(product(permutations(range(dof)), product((1.0, -1.0), repeat=dof)))
        orders, signs = (np.array(values) for values in zip(*pairs, strict=True))
        weights = np.zeros((len(pairs), dof, dof))
        np.put_along_axis(weights, orders[:, :, None], signs[:, :, None], axis=2)
        return cls(orders, signs, weights.reshape(len(pairs), -1))


def evidences(
    Y: Float[np.ndarray, "rows columns"],
    p_0: Float[np.ndarray, " columns"],
    scale: Float[np.ndarray, " columns"],
    offsets: Float[np.ndarray, "rows drives"],
    E: Float[np.ndarray, "rows pairs"],
    patterns: Patterns,
) -> Float[np.ndarray, " patterns"]:
    """Log evidence of each pattern.

    Args:
        p_0, scale: prior of the parameters that Y has columns of, and their sizes.
        offsets: columns of a constant torque of each drive.
    """
    expected, weights = Y @ p_0, patterns.weights.T
    size = np.sqrt(np.sum(weights * (E.T @ E @ weights), axis=0))
    usual = float(np.linalg.norm(expected))
    by = np.where(np.abs(np.log(usual / size)) < np.log(_UNIT), 1.0, usual / size)
    U, s, _ = np.linalg.svd(np.hstack([Y * scale, _OFFSET * offsets]), full_matrices=False)
    along = (U.T @ E @ weights) * by - (U.T @ expected)[:, None]
    total = (size * by) ** 2 - 2 * by * (expected @ E @ weights) + usual**2
    across = np.maximum(total - np.sum(along**2, axis=0), 0.0)
    rows, spread = len(Y), 1 + _RATIOS[:, None] * s**2
    left = across + (1 / spread) @ along**2
    share = left / (size * by) ** 2 + _LEAST**2
    noise = share * (size * by) ** 2 / rows
    wide = 0.5 * np.log(_RATIOS[:, None] * noise) - np.log(_SPREAD)
    level = np.log(share * size**2 / rows)
    values = -0.5 * rows * level - 0.5 * np.log(spread).sum(axis=1)[:, None]
    return np.max(values - 0.5 * (wide / _FACTOR) ** 2, axis=0)


@dataclass(frozen=True)
class Consistent:
    """The fit of a robot that may exist.

    Attributes:
        score: log likelihood and log prior of it.
        left: share of the torques that it leaves, of each drive alike.
        distance: d² to the prior; below some 10 where bodies are as described.
    """

    score: float
    left: float
    distance: float


IMPOSSIBLE = Consistent(-np.inf, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class Posed:
    """Torques in the order and sign of the drives, A x = b over what is free of a robot, each drive
    as a share of its torques."""

    reduction: Reduction
    regularizer: Regularizer
    A: Float[np.ndarray, "drives samples free"]
    b: Float[np.ndarray, "drives samples"]

    @classmethod
    def of(
        cls,
        dynamics: Dynamics,
        columns: Int[np.ndarray, " columns"],
        Y: Float[np.ndarray, "drives samples columns"],
        tau: Float[np.ndarray, "drives samples"],
        weights: Float[np.ndarray, " drives"],
    ) -> "Posed":
        """Args:
        weights: of each drive's rows, 1 for one whose torques count.
        """
        expected = Y @ np.array([entry.prior for entry in dynamics.layout.parameters])[columns]
        sizes = np.sqrt(np.mean(tau**2, axis=1))
        sizes = np.maximum(sizes, 1e-6 * sizes.max(initial=1e-300))
        by = np.linalg.norm(expected * weights[:, None]) / np.linalg.norm(tau * weights[:, None])
        by = 1.0 if abs(np.log(by)) < np.log(_UNIT) else by
        reduction, regularizer = _prior(dynamics, tuple(columns.tolist()))
        rows = (weights / (by * sizes))[:, None]
        A = Y @ reduction.A[columns] * rows[:, :, None]
        b = by * tau * rows - Y @ reduction.p_0[columns] * rows
        return cls(reduction, regularizer, A, b)

    @cached_property
    def highest(self) -> float:
        """No robot has a higher score: that of the least squares of any masses and constants."""
        left = Quadratic.of(self._rows(1.0)).c
        return -self.b.size * float(np.log(self._level(left)))

    @cached_property
    def fit(self) -> Consistent:
        """Of a robot that may exist."""
        noise, best = 0.02, IMPOSSIBLE
        for _ in range(_ROUNDS):
            data = Quadratic.of(self._rows(_whitened(self.b.shape[1], noise)) / noise)
            objective = Objective(self.reduction, data, self.regularizer, _GAMMA)
            try:
                solution = _SOLVER.solve(objective)
            except IdentificationError:
                return IMPOSSIBLE
            misfit = data.evaluate(solution.x)[0]
            distance, settled = solution.objective - misfit, self._level(misfit * noise**2)
            score = float(-self.b.size * np.log(settled) - 0.5 * distance)
            best, before, noise = Consistent(score, settled, distance), noise, settled
            if abs(np.log(noise / before)) < _SETTLED:
                break
        return best

    def _rows(self, constant: float) -> Float[np.ndarray, "rows augmented"]:
        """[A b] without a share of each drive's mean."""
        rows = np.concatenate([self.A, self.b[:, :, None]], axis=2)
        rows = rows - constant * rows.mean(axis=1, keepdims=True)
        return rows.reshape(-1, rows.shape[2])

    def _level(self, squares: float) -> float:
        """Share of the torques that squares of so much leave."""
        return float(np.sqrt(squares / self.b.size + _LEAST**2))


@lru_cache(maxsize=8)
def _prior(dynamics: Dynamics, columns: tuple[int, ...]) -> tuple[Reduction, Regularizer]:
    """What every hypothesis about columns is fitted with."""
    reduction = build_reduction(dynamics.robot, np.array(columns))
    return reduction, METRICS["entropic"].regularizer(reduction)


def _whitened(samples: int, noise: float) -> float:
    """What of a mean is taken off so that a constant of the usual size is as likely as noise: a
    constant torque of a drive costs what its prior says."""
    return 1 - 1 / np.sqrt(1 + samples * (_OFFSET / noise) ** 2)
