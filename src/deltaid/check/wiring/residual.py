"""What least squares leaves of torques, for every order, sign and gain of their columns at once.

E_ij is the torque column j in the rows of drive i, and S = Eᵀ(1 − Y Y⁺)E. So the residual of any
assignment u of torque columns to drives, with signs and gains, is uᵀS u, and its share of the
torques uᵀS u / uᵀD u with D = diag ‖E_ij‖².
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.check.wiring.motion import Motion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.information import entries_at
from deltaid.estimation.span import Span
from deltaid.mechanism.regularity import SINGULAR_CONDITION

# Weight of a drive at rest, whose torque friction balances as it likes.
_AT_REST = 1e-3


@dataclass(frozen=True)
class Map:
    """How joint values follow from position columns: q_i = scale_i · column order_i + shift_i."""

    scale: tuple[float, ...]
    order: tuple[int, ...]
    shift: tuple[float, ...]

    @classmethod
    def identity(cls, dof: int) -> "Map":
        """As the mapping says."""
        return cls((1.0,) * dof, tuple(range(dof)), (0.0,) * dof)

    def values(self, q: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        """q of columns."""
        return q[:, list(self.order)] * self.scale + self.shift

    def rates(self, qd: Float[np.ndarray, "samples dof"]) -> Float[np.ndarray, "samples dof"]:
        """q̇ or q̈ of columns."""
        return qd[:, list(self.order)] * self.scale


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a stretch under a map.

    Attributes:
        z: (samples, dof).
        good: where the loops close, in a regular pose on the branch of most of the samples.
        worst: condition number there.
    """

    z: Float[np.ndarray, "samples dof"]
    good: Bool[np.ndarray, " samples"]
    worst: Float[np.ndarray, " samples"]

    @property
    def share(self) -> float:
        """Of the samples that are good."""
        return float(np.mean(self.good))


def poses(dynamics: Dynamics, q: Float[np.ndarray, "samples dof"]) -> Poses:
    """Where the loops close."""
    z, closed = dynamics.kinematics.forward_unchecked(q)
    z = np.where(closed[:, None], z, dynamics.kinematics.home)
    regular = dynamics.kinematics.regularity(z)
    good = closed & (regular.worst < SINGULAR_CONDITION)
    sign = np.sign(regular.determinant)
    good &= sign == (1 if sign[good].sum() >= 0 else -1)
    return Poses(z, good, np.where(good, regular.worst, np.inf))


@dataclass(frozen=True, eq=False)
class Residual:
    """Least squares of all torque columns under one map of the positions.

    Attributes:
        map: of the positions.
        poses: of the samples.
        Y, E: weighted rows, one drive under the other.
        span: of Y.
        S: residual of E, (drives², drives²), by drive i and column j.
        D: squares of E's columns, (drives, drives).
        weights: of the rows of each drive.
        along: correlation of drive i's torque at the prior with column j, (drives, drives).
        prior: root mean square of the torque at the prior.
        still: drives at rest, whose torques are friction's and tell no sign.
        keep: which of the kept samples are used.
        columns: parameters that columns of Y stand for.
    """

    map: Map
    poses: Poses
    Y: Float[np.ndarray, "rows columns"]
    E: Float[np.ndarray, "rows pairs"]
    span: Span
    S: Float[np.ndarray, "pairs pairs"]
    D: Float[np.ndarray, "dof dof"]
    weights: Float[np.ndarray, " dof"]
    along: Float[np.ndarray, "dof dof"]
    prior: Float[np.ndarray, " dof"]
    still: Bool[np.ndarray, " dof"]
    keep: Bool[np.ndarray, " kept"]
    columns: np.ndarray

    def of(self, order: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """S and D of one order of the torque columns, for their gains."""
        n = len(order)
        at = np.arange(n) * n + np.array(order)
        return self.S[np.ix_(at, at)], self.D.ravel()[at]

    def share(self, order: tuple[int, ...], gains: np.ndarray) -> float:
        """What is left of the torques, as a share of their root mean square."""
        S, D = self.of(order)
        return float(np.sqrt(max(gains @ S @ gains, 0.0) / (gains**2 @ D)))

    def own_share(self, order: tuple[int, ...], gains: np.ndarray) -> float:
        """The same with the rows of each drive divided by its gain.

        So a drive that is explained well by itself gets no weight from a large gain.
        """
        by = np.repeat(np.abs(gains), len(self.Y) // len(order))
        tau = self.torques(order, gains) / by
        left = Span.of(self.Y / by[:, None]).without(tau)
        return float(np.linalg.norm(left) / np.linalg.norm(tau))

    def torques(self, order: tuple[int, ...], gains: np.ndarray) -> Float[np.ndarray, " rows"]:
        """Torque columns in an order, times gains, as weighted rows."""
        n = len(order)
        return self.E[:, np.arange(n) * n + np.array(order)] @ gains

    def parameters(self, order: tuple[int, ...], gains: np.ndarray) -> np.ndarray:
        """The least-squares parameters of the visible columns, of least norm."""
        return self.span.coefficients(self.torques(order, gains))


def residual(dynamics: Dynamics, motion: Motion, map: Map) -> Residual | None:
    """None where too few samples have poses."""
    found = poses(dynamics, map.values(motion.q))
    if found.share < 0.2:
        return None
    return residual_at(dynamics, motion, map, found)


def residual_at(dynamics: Dynamics, motion: Motion, map: Map, found: Poses) -> Residual | None:
    dof = dynamics.dof
    qd, qdd = map.rates(motion.qd), map.rates(motion.qdd)
    values = np.where(found.good, entries_at(dynamics, found.z, qd, qdd, motion.load), 0.0)
    Y = motion.filtered(values)
    keep = motion.awake
    if not found.good.all():
        keep = keep & (motion.filtered(found.good[None].astype(float))[0] > 1 - 1e-6)
    if keep.sum() < 30:
        return None
    Y, tau = Y[:, keep], motion.tau[keep].T
    rows, entries = dynamics.regressor_pattern
    columns = np.unique(entries)
    p = prior_parameters(dynamics.robot)
    expected = np.stack([(p[entries[rows == i]] @ Y[rows == i]) for i in range(dof)])
    prior = np.sqrt(np.mean(expected**2, axis=1))
    still = ~motion.moves[list(map.order)]
    weights = np.where(still, _AT_REST, 1.0) / np.maximum(prior, 1e-3 * prior.max())
    count = Y.shape[1]
    rows_of_Y, E = np.zeros((dof, count, len(columns))), np.zeros((dof, count, dof, dof))
    for i in range(dof):
        own = np.searchsorted(columns, entries[rows == i])
        rows_of_Y[i][:, own] = weights[i] * Y[rows == i].T
        E[i, :, i] = weights[i] * tau.T
    Y, E = rows_of_Y.reshape(dof * count, -1), E.reshape(dof * count, -1)
    span = Span.of(Y)
    left = span.without(E)
    D = np.sum(E**2, axis=0).reshape(dof, dof)
    sizes = np.outer(np.linalg.norm(expected, axis=1), np.linalg.norm(tau, axis=1))
    along = expected @ tau.T / np.maximum(sizes, np.finfo(float).tiny)
    return Residual(
        map, found, Y, E, span, left.T @ left, D, weights, along, prior, still, keep, columns
    )
