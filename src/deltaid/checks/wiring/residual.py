"""Least squares of torques under one map of the positions, how likely each order and sign of the
torque columns is, and the fit of a consistent robot to them.

Torques of a robot near its prior are normal: with p ~ N(p₀, α² S²), offsets o of the drives and
white noise, E u = Y p + X o + e, so that every assignment u of torque columns to drives has a
closed evidence. E_ij is the torque column j in the rows of drive i.

What decides between hypotheses is the fit of a robot that may exist,

    −2 log L = N log σ² + ‖W(E u − Y p)‖²/σ² + d²(p, p₀),   p in its cones,

with the entropic distance d² to the prior: a wrong sign explains a poor motion by masses that no
body has. Rows W are shares of each drive's recorded torque, so that units do not decide.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.checks.wiring.motion import FilteredMotion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.drive_rows import DriveRows, of_own_drives
from deltaid.estimation.information import entries_at
from deltaid.estimation.objective import METRICS, Objective, Quadratic, Regularizer
from deltaid.estimation.problem import Span
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.mechanism.regularity import SINGULAR_CONDITION

# Weight of a drive at rest, whose torque friction balances as it likes.
_AT_REST = 1e-3
# Least share of the samples that have poses, and number of them.
_POSED, _FEWEST = 0.2, 30
# No model leaves less of a machine's torques than this share, and a drive's torque sensor is off by
# about this share of its torques.
_LEAST, _OFFSET = 0.003, 0.1
# Torques are scaled to those of the prior where they are so far from them: in another unit.
_UNIT = 2.5
# Parameters are off their prior by about so much of themselves, as a median and the spread of its
# logarithm, bodies by about a factor e; steps of α²/σ² that are tried.
_SPREAD, _FACTOR, _RATIOS = 0.7, 1.0, np.geomspace(1e-2, 1e8, 41)
# γ of the prior; rounds of fit and noise level, and change of the latter that ends them.
_GAMMA, _ROUNDS, _SETTLED = 1.0, 4, 0.05
_SOLVER = Conic(tolerance=1e-7, largest_gap=1e-2)


@dataclass(frozen=True)
class Map:
    """How joint values follow from position columns: q_i = scale_i · column order_i + shift_i."""

    scale: tuple[float, ...]
    order: tuple[int, ...]
    shift: tuple[float, ...]

    @classmethod
    def identity(cls, dof: int) -> "Map":
        return cls((1.0,) * dof, tuple(range(dof)), (0.0,) * dof)

    def values(self, q: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        return self.rates(q) + self.shift

    def rates(self, qd: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        """q̇ or q̈ of columns."""
        return qd[:, list(self.order)] * self.scale

    def times(self, factor: float, drives: Iterable[int]) -> "Map":
        """The same with the scale of some drives times a factor."""
        scale = (f * factor if i in drives else f for i, f in enumerate(self.scale))
        return replace(self, scale=tuple(scale))

    @property
    def scaled(self) -> list[int]:
        """Drives whose positions are in another unit or of another shaft."""
        return [i for i, factor in enumerate(self.scale) if abs(factor) != 1]


@dataclass(frozen=True, eq=False)
class Patterns:
    """Orders and signs of torque columns: all there are, in a fixed sequence."""

    orders: Int[np.ndarray, "patterns drives"]
    signs: Float[np.ndarray, "patterns drives"]
    weights: Float[np.ndarray, "patterns pairs"]  # of columns of E, by drive and torque column

    @classmethod
    @lru_cache
    def all_of(cls, dof: int) -> "Patterns":
        """n! orders with 2ⁿ signs each, the first one as mapped."""
        pairs = list(product(permutations(range(dof)), product((1.0, -1.0), repeat=dof)))
        orders, signs = (np.array(values) for values in zip(*pairs, strict=True))
        weights = np.zeros((len(pairs), dof, dof))
        np.put_along_axis(weights, orders[:, :, None], signs[:, :, None], axis=2)
        return cls(orders, signs, weights.reshape(len(pairs), -1))


@dataclass(frozen=True, eq=False)
class MapResidual:
    """Least squares under one map of the positions."""

    dynamics: Dynamics
    map: Map
    z: Float[np.ndarray, "samples dof"]  # poses
    share: float  # of samples where the loops close, regular and on the branch of most
    rows: DriveRows  # how samples of drives stand under each other in Y
    tau: Float[np.ndarray, "used dof"]  # as recorded, a column as in the mapping
    Y: Float[np.ndarray, "rows columns"]
    columns: Int[np.ndarray, " columns"]  # parameters that columns of Y stand for
    prior: Float[np.ndarray, " columns"]
    still: Bool[np.ndarray, " dof"]  # at rest torques are friction's and determine no sign
    keep: Bool[np.ndarray, " kept"]  # which of the kept samples are used

    @cached_property
    def span(self) -> Span:
        return Span.of_columns(self.Y)

    @cached_property
    def along(self) -> Float[np.ndarray, "dof dof"]:
        """Correlation of drive i's torque at the prior with column j."""
        expected = self.rows.of_drives(self.Y @ self.prior)
        sizes = np.outer(np.linalg.norm(expected, axis=1), np.linalg.norm(self.tau, axis=0))
        return expected @ self.tau / np.maximum(sizes, np.finfo(float).tiny)

    @property
    def scale(self) -> Float[np.ndarray, " columns"]:
        """Sizes of the parameters."""
        return np.array([self.dynamics.layout.parameters[k].scale for k in self.columns])

    @cached_property
    def evidences(self) -> Float[np.ndarray, " patterns"]:
        """Log evidence of each of `Patterns.all_of`."""
        dof, rows = len(self.still), len(self.Y)
        E = self.rows.stack(of_own_drives(np.broadcast_to(self.tau, (dof, *self.tau.shape))))
        offsets = np.diag(np.where(self.still, _AT_REST, 1.0)).repeat(self.rows.samples, axis=0)
        expected, weights = self.Y @ self.prior, Patterns.all_of(dof).weights.T
        size = np.sqrt(np.sum(weights * (E.T @ E @ weights), axis=0))
        usual = float(np.linalg.norm(expected))
        by = np.where(np.abs(np.log(usual / size)) < np.log(_UNIT), 1.0, usual / size)
        columns = np.hstack([self.Y * self.scale, _OFFSET * offsets])
        U, s, _ = np.linalg.svd(columns, full_matrices=False)
        along = (U.T @ E @ weights) * by - (U.T @ expected)[:, None]
        total = (size * by) ** 2 - 2 * by * (expected @ E @ weights) + usual**2
        across = np.maximum(total - np.sum(along**2, axis=0), 0.0)
        spread = 1 + _RATIOS[:, None] * s**2
        share = (across + (1 / spread) @ along**2) / (size * by) ** 2 + _LEAST**2
        noise = share * (size * by) ** 2 / rows
        wide = 0.5 * np.log(_RATIOS[:, None] * noise) - np.log(_SPREAD)
        level = np.log(share * size**2 / rows)
        values = -0.5 * rows * level - 0.5 * np.log(spread).sum(axis=1)[:, None]
        values = np.max(values - 0.5 * (wide / _FACTOR) ** 2, axis=0)
        # Of torques as shares of themselves, whatever the weights of rows under this map.
        sizes = rms_torques(self.tau.T)
        return values + self.rows.samples * float(np.log(sizes / self.rows.scale).sum())


def rms_torques(tau: Float[np.ndarray, "drives samples"]) -> Float[np.ndarray, " drives"]:
    """Root mean squares, none of them zero."""
    sizes = np.sqrt(np.mean(tau**2, axis=1))
    return np.maximum(sizes, 1e-6 * sizes.max(initial=np.finfo(float).tiny))


def poses(
    dynamics: Dynamics, q: Float[np.ndarray, "samples dof"]
) -> tuple[Float[np.ndarray, "samples dof"], Bool[np.ndarray, " samples"]]:
    """Poses z, and where the loops close, regular and on the branch of most."""
    z, closed = dynamics.kinematics.forward_unchecked(q)
    z = np.where(closed[:, None], z, dynamics.kinematics.home)
    regular = dynamics.kinematics.regularity(z)
    good = closed & (regular.worst < SINGULAR_CONDITION)
    sign = np.sign(regular.determinant)
    return z, good & (sign == (1 if sign[good].sum() >= 0 else -1))


def residual(dynamics: Dynamics, motion: FilteredMotion, map: Map) -> MapResidual | None:
    """None where too few samples have poses."""
    z, good = poses(dynamics, map.values(motion.q))
    keep, share = motion.awake, float(good.mean())
    if share < _POSED:
        return None
    if not good.all():
        keep = keep & (motion.filtered(good[None].astype(float))[0] > 1 - 1e-6)
    if keep.sum() < _FEWEST:
        return None
    qd, qdd = map.rates(motion.qd), map.rates(motion.qdd)
    values = np.where(good, entries_at(dynamics, z, qd, qdd, motion.load), 0.0)
    tau, (drives, entries) = motion.tau[keep], dynamics.regressor_pattern
    columns, place = np.unique(entries, return_inverse=True)
    Y = np.zeros((dynamics.dof, len(tau), len(columns)))
    Y[drives, :, place] = motion.filtered(values)[:, keep]
    prior = prior_parameters(dynamics.robot)[columns]
    expected = np.sqrt(np.mean((Y @ prior) ** 2, axis=1))
    still = ~motion.moves[list(map.order)]
    scale = np.maximum(expected, 1e-3 * expected.max()) / np.where(still, _AT_REST, 1.0)
    rows = DriveRows(scale, len(tau))
    Y = rows.stack(Y)
    return MapResidual(dynamics, map, z, share, rows, tau, Y, columns, prior, still, keep)


@dataclass(frozen=True)
class Consistent:
    """The fit of a robot that may exist."""

    score: float  # log likelihood and log prior of it
    left: float  # share of the torques that it leaves, of each drive alike
    distance: float  # d² to the prior; below some 10 where bodies are as described


IMPOSSIBLE = Consistent(-np.inf, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class Posed:
    """Torques in the order of the drives as rows [A b], A x = b over what is free of a robot, each
    drive as a share of its torques."""

    reduction: Reduction
    regularizer: Regularizer
    rows: Float[np.ndarray, "drives samples augmented"]

    @classmethod
    def from_residual(
        cls, residual: MapResidual, tau: Float[np.ndarray, "drives samples"]
    ) -> "Posed":
        """Of torques of each drive, under the map of a residual."""
        of_rows, columns = residual.rows, residual.columns
        Y = residual.Y.reshape(*tau.shape, -1) * of_rows.scale[:, None, None]
        weights, sizes = np.where(residual.still, _AT_REST, 1.0), rms_torques(tau)
        expected = Y @ residual.prior * weights[:, None]
        by = np.linalg.norm(expected) / np.linalg.norm(tau * weights[:, None])
        by = 1.0 if abs(np.log(by)) < np.log(_UNIT) else by
        reduction, regularizer = _prior(residual.dynamics, tuple(columns.tolist()))
        A, b = Y @ reduction.A[columns], by * tau - Y @ reduction.p_0[columns]
        rows = np.concatenate([A, b[:, :, None]], axis=2)
        return cls(reduction, regularizer, rows * (weights / (by * sizes))[:, None, None])

    @cached_property
    def highest(self) -> float:
        """No robot has a higher score: that of the least squares of any masses and constants."""
        left = self._level(Quadratic.from_rows(self._without_constant(1.0)).c)
        return -self._size * float(np.log(left))

    @cached_property
    def fit(self) -> Consistent:
        """Of a robot that may exist."""
        noise, best = 0.02, IMPOSSIBLE
        for _ in range(_ROUNDS):
            # A constant torque costs what its prior says: one of usual size is as likely as noise.
            constant = 1 - 1 / np.sqrt(1 + self.rows.shape[1] * (_OFFSET / noise) ** 2)
            data = Quadratic.from_rows(self._without_constant(constant) / noise)
            try:
                solution = _SOLVER.solve(Objective(self.reduction, data, self.regularizer, _GAMMA))
            except IdentificationError:
                return IMPOSSIBLE
            misfit, before = data.evaluate(solution.x)[0], noise
            distance, noise = solution.objective - misfit, self._level(misfit * noise**2)
            best = Consistent(float(-self._size * np.log(noise) - 0.5 * distance), noise, distance)
            if abs(np.log(noise / before)) < _SETTLED:
                break
        return best

    def _without_constant(self, share: float) -> Float[np.ndarray, "rows augmented"]:
        """The rows without a share of each drive's mean."""
        rows = self.rows - share * self.rows.mean(axis=1, keepdims=True)
        return rows.reshape(-1, rows.shape[2])

    @property
    def _size(self) -> int:
        return self.rows.shape[0] * self.rows.shape[1]

    def _level(self, squares: float) -> float:
        """Share of the torques that squares of so much leave."""
        return float(np.sqrt(squares / self._size + _LEAST**2))


@lru_cache(maxsize=8)
def _prior(dynamics: Dynamics, columns: tuple[int, ...]) -> tuple[Reduction, Regularizer]:
    """What every hypothesis about columns is fitted with."""
    reduction = build_reduction(dynamics.robot, np.array(columns))
    return reduction, METRICS["entropic"].regularizer(reduction)
