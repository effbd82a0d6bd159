"""Least-squares residuals of torques for every order, sign and gain of their columns at once.

E_ij is the torque column j in the rows of drive i, and S = Eᵀ(1 − Y Y⁺)E. So the residual of any
assignment u of torque columns to drives, with signs and gains, is uᵀS u, and its share of the
torques uᵀS u / uᵀD u with D = diag ‖E_ij‖².
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.check.wiring.contest import Patterns, Posed, evidences
from deltaid.check.wiring.motion import Motion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.drive_rows import DriveRows, of_own_drives
from deltaid.estimation.information import entries_at
from deltaid.estimation.span import Span
from deltaid.mechanism.regularity import SINGULAR_CONDITION

# Weight of a drive at rest, whose torque friction balances as it likes.
_AT_REST = 1e-3
# Least share of the samples that have poses, and number of them.
_POSED, _FEWEST = 0.2, 30


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
class Poses:
    """Poses z of a stretch, `good` where the loops close, regular and on the branch of most."""

    z: Float[np.ndarray, "samples dof"]
    good: Bool[np.ndarray, " samples"]

    @property
    def share(self) -> float:
        """Of the samples that are good."""
        return float(np.mean(self.good))


def poses(dynamics: Dynamics, q: Float[np.ndarray, "samples dof"]) -> Poses:
    z, closed = dynamics.kinematics.forward_unchecked(q)
    z = np.where(closed[:, None], z, dynamics.kinematics.home)
    regular = dynamics.kinematics.regularity(z)
    good = closed & (regular.worst < SINGULAR_CONDITION)
    sign = np.sign(regular.determinant)
    return Poses(z, good & (sign == (1 if sign[good].sum() >= 0 else -1)))


@dataclass(frozen=True, eq=False)
class Residual:
    """Least squares of all torque columns under one map of the positions.

    Attributes:
        rows: how samples of drives stand under each other in Y and E.
        span: of Y.
        S: residual of E, by drive i and column j in either direction.
        D: squares of E's columns, by drive and column.
        along: correlation of drive i's torque at the prior with column j.
        tau: torques as recorded, of the samples used, a column as in the mapping.
        still: drives at rest, whose torques are friction's and determine no sign.
        keep: which of the kept samples are used.
        columns: parameters that columns of Y stand for.
    """

    dynamics: Dynamics
    map: Map
    poses: Poses
    rows: DriveRows
    tau: Float[np.ndarray, "samples dof"]
    Y: Float[np.ndarray, "rows columns"]
    E: Float[np.ndarray, "rows pairs"]
    span: Span
    S: Float[np.ndarray, "pairs pairs"]
    D: Float[np.ndarray, "dof dof"]
    along: Float[np.ndarray, "dof dof"]
    still: Bool[np.ndarray, " dof"]
    keep: Bool[np.ndarray, " kept"]
    columns: Int[np.ndarray, " columns"]

    def of(self, order: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """S and D of one order of the torque columns, for their gains."""
        pairs = _pairs(order)
        return self.S[np.ix_(pairs, pairs)], self.D.ravel()[pairs]

    def share(self, order: tuple[int, ...], gains: np.ndarray) -> float:
        """Residual as a share of the torques' root mean square."""
        S, D = self.of(order)
        return float(np.sqrt(max(gains @ S @ gains, 0.0) / (gains**2 @ D)))

    def own_share(self, order: tuple[int, ...], gains: np.ndarray) -> float:
        """The same with each drive's rows divided by its gain: a large gain adds no weight."""
        by = np.repeat(np.abs(gains), self.rows.samples)
        tau = self.torques(order, gains) / by
        residual = Span.of(self.Y / by[:, None]).without(tau)
        return float(np.linalg.norm(residual) / np.linalg.norm(tau))

    @cached_property
    def evidences(self) -> Float[np.ndarray, " patterns"]:
        """Log evidence of each of `Patterns.all_of`."""
        entries = [self.dynamics.layout.parameters[k] for k in self.columns]
        p_0, scale = (np.array(x) for x in zip(*((e.prior, e.scale) for e in entries), strict=True))
        offsets = np.repeat(np.eye(len(self.still)), self.rows.samples, axis=0)
        offsets /= np.where(self.still, 1 / _AT_REST, 1.0)
        patterns = Patterns.all_of(len(self.still))
        of_rows = evidences(self.Y, p_0, scale, offsets, self.E, patterns)
        # Of torques as shares of themselves, whatever the weights of rows under this map.
        sizes = np.sqrt(np.mean(self.tau**2, axis=0))
        sizes = np.maximum(sizes, 1e-6 * sizes.max(initial=np.finfo(float).tiny))
        return of_rows + self.rows.samples * float(np.log(sizes / self.rows.scale).sum())

    def posed(self, order: tuple[int, ...], gains: np.ndarray) -> Posed:
        """Torque columns in an order, times gains, to be fitted by a robot that may exist."""
        Y = self.Y.reshape(len(order), self.rows.samples, -1) * self.rows.scale[:, None, None]
        weights = np.where(self.still, _AT_REST, 1.0)
        return Posed.of(
            self.dynamics, self.columns, Y, (self.tau[:, list(order)] * gains).T, weights
        )

    def torques(self, order: tuple[int, ...], gains: np.ndarray) -> Float[np.ndarray, " rows"]:
        """Torque columns in an order, times gains, as weighted rows."""
        return self.E[:, _pairs(order)] @ gains


def _pairs(order: tuple[int, ...]) -> Int[np.ndarray, " dof"]:
    """Where E has the torque column of each drive."""
    return np.arange(len(order)) * len(order) + np.array(order)


def residual(dynamics: Dynamics, motion: Motion, map: Map) -> Residual | None:
    """None where too few samples have poses."""
    reached = poses(dynamics, map.values(motion.q))
    if reached.share < _POSED:
        return None
    qd, qdd = map.rates(motion.qd), map.rates(motion.qdd)
    values = np.where(reached.good, entries_at(dynamics, reached.z, qd, qdd, motion.load), 0.0)
    keep = motion.awake
    if not reached.good.all():
        keep = keep & (motion.filtered(reached.good[None].astype(float))[0] > 1 - 1e-6)
    if keep.sum() < _FEWEST:
        return None
    tau, (drives, entries) = motion.tau[keep], dynamics.regressor_pattern
    columns, place = np.unique(entries, return_inverse=True)
    Y = np.zeros((dynamics.dof, len(tau), len(columns)))
    Y[drives, :, place] = motion.filtered(values)[:, keep]
    expected = Y @ np.array([dynamics.layout.parameters[k].prior for k in columns])
    prior = np.sqrt(np.mean(expected**2, axis=1))
    still = ~motion.moves[list(map.order)]
    scale = np.maximum(prior, 1e-3 * prior.max()) / np.where(still, _AT_REST, 1.0)
    rows = DriveRows(scale, len(tau))
    E = rows.stack(of_own_drives(np.broadcast_to(tau, (dynamics.dof, *tau.shape))))
    Y = rows.stack(Y)
    span = Span.of(Y)
    rest = span.without(E)
    D = np.sum(E**2, axis=0).reshape(still.size, -1)
    sizes = np.outer(np.linalg.norm(expected, axis=1), np.linalg.norm(tau, axis=0))
    along = expected @ tau / np.maximum(sizes, np.finfo(float).tiny)
    S = rest.T @ rest
    return Residual(
        dynamics, map, reached, rows, tau, Y, E, span, S, D, along, still, keep, columns
    )
