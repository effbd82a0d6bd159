"""Least squares of torques under one map of the positions, and how likely each order and sign of
the torque columns is.

Torques of a robot near its prior are normal: with p ~ N(p₀, α² S²), offsets o of the drives and
white noise, E u = Y p + X o + e, so that every assignment u of torque columns to drives has a
closed evidence. E_ij is the torque column j in the rows of drive i.
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
from deltaid.estimation.drive_rows import DriveRows, of_own_drives
from deltaid.estimation.information import entries_at
from deltaid.estimation.problem import Span
from deltaid.mechanism.regularity import SINGULAR_CONDITION

# Weight of a drive at rest, whose torque friction balances as it likes.
AT_REST = 1e-3
# Least share of the samples that have poses, and number of them.
_POSED, _FEWEST = 0.2, 30
# No model leaves less of a machine's torques than this share, and a drive's torque sensor is off by
# about this share of its torques.
LEAST, OFFSET = 0.003, 0.1
# Torques are scaled to those of the prior where they are so far from them: in another unit.
UNIT = 2.5
# Parameters are off their prior by about so much of themselves, as a median and the spread of its
# logarithm, bodies by about a factor e; steps of α²/σ² that are tried.
_SPREAD, _FACTOR, _RATIOS = 0.7, 1.0, np.geomspace(1e-2, 1e8, 41)


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


@lru_cache
def patterns(
    dof: int,
) -> tuple[Int[np.ndarray, "patterns drives"], Float[np.ndarray, "patterns drives"]]:
    """Orders and signs of torque columns: n! orders with 2ⁿ signs each, the first one as mapped."""
    pairs = list(product(permutations(range(dof)), product((1.0, -1.0), repeat=dof)))
    return np.array([order for order, _ in pairs]), np.array([signs for _, signs in pairs])


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
        return np.array([self.dynamics.layout.parameters[k].scale for k in self.columns])

    @cached_property
    def evidences(self) -> Float[np.ndarray, " patterns"]:
        """Log evidence of each of `patterns`."""
        dof, rows = len(self.still), len(self.Y)
        E = self.rows.stack(of_own_drives(np.broadcast_to(self.tau, (dof, *self.tau.shape))))
        offsets = np.diag(np.where(self.still, AT_REST, 1.0)).repeat(self.rows.samples, axis=0)
        orders, signs = patterns(dof)
        # Weights of columns of E, by drive and torque column.
        weights = (np.eye(dof)[orders] * signs[:, :, None]).reshape(len(orders), -1).T
        expected = self.Y @ self.prior
        size = np.sqrt(np.sum(weights * (E.T @ E @ weights), axis=0))
        usual = float(np.linalg.norm(expected))
        by = np.where(np.abs(np.log(usual / size)) < np.log(UNIT), 1.0, usual / size)
        columns = np.hstack([self.Y * self.scale, OFFSET * offsets])
        U, s, _ = np.linalg.svd(columns, full_matrices=False)
        along = (U.T @ E @ weights) * by - (U.T @ expected)[:, None]
        total = (size * by) ** 2 - 2 * by * (expected @ E @ weights) + usual**2
        across = np.maximum(total - np.sum(along**2, axis=0), 0.0)
        spread = 1 + _RATIOS[:, None] * s**2
        share = (across + (1 / spread) @ along**2) / (size * by) ** 2 + LEAST**2
        wide = 0.5 * np.log(_RATIOS[:, None] * (share * (size * by) ** 2 / rows)) - np.log(_SPREAD)
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
    good, sign = closed & (regular.worst < SINGULAR_CONDITION), np.sign(regular.determinant)
    return z, good & (sign == (1 if sign[good].sum() >= 0 else -1))


def residual(dynamics: Dynamics, motion: FilteredMotion, map: Map) -> MapResidual | None:
    """None where too few samples have poses."""
    z, good = poses(dynamics, map.values(motion.q))
    keep, share = motion.awake, float(good.mean())
    if not good.all() and share >= _POSED:
        keep = keep & (motion.filtered(good[None].astype(float))[0] > 1 - 1e-6)
    if share < _POSED or keep.sum() < _FEWEST:
        return None
    qd, qdd = map.rates(motion.qd), map.rates(motion.qdd)
    values = np.where(good, entries_at(dynamics, z, qd, qdd, motion.load), 0.0)
    tau, (drives, entries) = motion.tau[keep], dynamics.regressor_pattern
    columns, place = np.unique(entries, return_inverse=True)
    Y = np.zeros((dynamics.dof, len(tau), len(columns)))
    Y[drives, :, place] = motion.filtered(values)[:, keep]
    prior, still = prior_parameters(dynamics.robot)[columns], ~motion.moves[list(map.order)]
    expected = np.sqrt(np.mean((Y @ prior) ** 2, axis=1))
    scale = np.maximum(expected, 1e-3 * expected.max()) / np.where(still, AT_REST, 1.0)
    rows = DriveRows(scale, len(tau))
    Y = rows.stack(Y)
    return MapResidual(dynamics, map, z, share, rows, tau, Y, columns, prior, still, keep)
