"""Kalman filter in covariance form, written out, for constants and slowly varying states.

States are in units of their prior, whose covariance is the identity. From cycle to cycle state i
forgets: its covariance goes back to the prior's,

    P ← D P D + (1 − D²),   D = diag(φ),

so it stays between zero and the prior without measurements (no wind-up), and positive semidefinite.
Measurements are processed one number after the other, without a matrix to invert.

The size of unmodelled torques d, one number per drive, is learnt. It is

    a + b / (1 + (q̇/v)²),

a while the drive moves and b more where it is slow. In units of that size E(d²) = 1, so d² + P_dd
above 1 shows that a and b are larger than assumed, below 1 that they are smaller; each learns by
its share.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.online.graph import CycleFields, Field

# Memory [s] of the model's errors, and of unmodelled torques.
_MODEL, UNMODELLED = 300.0, 0.05


@dataclass(frozen=True, eq=False)
class Update:
    """Update by one measured number: its row h of the states, the innovation and its variance, the
    gain, and the weight, 0 where it is not used."""

    row: ca.SX
    innovation: ca.SX
    variance: ca.SX
    gain: ca.SX
    counts: ca.SX


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean x and symmetric covariance P of the states."""

    x: ca.SX
    P: ca.SX

    def part(self, which: slice) -> "Estimate":
        """Mean and covariance of some states."""
        return Estimate(self.x[which], self.P[which, which])

    def forgotten(self, kept: ca.SX, prior: ca.SX, wanders: ca.SX) -> "Estimate":
        """The estimate a cycle later.

        Args:
            kept: φ of each state.
            prior: variance that each returns to.
            wanders: 1 where the mean returns to zero too, 0 where it stays.
        """
        P = self.P * (kept @ kept.T) + ca.diag(prior * (1 - kept * kept))
        return Estimate(self.x * (1 - wanders * (1 - kept)), P)

    def measured(
        self, row: ca.SX, value: ca.SX, variance: ca.SX, weight: ca.SX
    ) -> tuple["Estimate", Update]:
        """The estimate after one measured number, value = row·x plus noise of this variance.

        Args:
            weight: share of its information that is used, 0 for none.
        """
        moves, innovation = self.P @ row.T, value - row @ self.x
        total = (row @ moves) * weight + variance
        gain = moves * weight / total
        P = ca.tril2symm(ca.tril(self.P - gain @ moves.T))
        update = Update(row, innovation * weight, total, gain, weight)
        return Estimate(self.x + gain * innovation, P), update


class States:
    """The states and their memories.

    Attributes:
        stays: share of each that is kept over a cycle.
        wander: 1 for states whose mean is forgotten too.

    Args:
        kinds: of each: 0 load, 1 model, 2 friction, 3 unmodelled.
        period, friction_time: [s].
    """

    def __init__(self, kinds: np.ndarray, period: float, friction_time: float) -> None:
        self._loads, self.wander = kinds == 0, ca.SX((kinds == 3).astype(float))
        memory = np.array([np.inf, _MODEL, friction_time, UNMODELLED])[kinds]
        self.stays = ca.SX(np.exp(-period / memory))

    def before(self, fields: CycleFields) -> Estimate:
        """The estimate from the state of the previous cycle."""
        n, initial = len(self._loads), np.diag(np.where(self._loads, 0.0, 1.0))
        first = tuple(initial[np.triu_indices(n)].tolist())
        x, P = fields.keep(
            Field("x", n, "estimate, in deviations of its prior"),
            Field("P", len(first), "its covariance, columns of the lower triangle", initial=first),
        )
        return Estimate(x, ca.tril2symm(ca.SX(ca.Sparsity.lower(n), P)))

    def later(self, estimate: Estimate, held: ca.SX) -> Estimate:
        """The estimate a cycle later, before measurements.

        Args:
            held: 1 while a load was held.
        """
        prior = ca.vertcat(*(held if is_load else ca.SX(1) for is_load in self._loads))
        return estimate.forgotten(self.stays, prior, self.wander)


# Time constant of learnt sizes [s], their bounds, and the largest squared deviation that one cycle
# may contribute, in units of the variance.
LEARNT, _LEVELS, LARGEST_STEP = 2.0, (0.15, 20.0), 10.0
# States of a drive for which sizes are learnt, in units of the initial ones.
DRIVES = ("moving", "slow")


def learn_levels(
    fields: CycleFields, parts: tuple[ca.SX, ca.SX], d: Estimate, calm: ca.SX, period: float
) -> None:
    """Set the following sizes of unmodelled torques.

    Args:
        parts: a, and the contribution of b.
        d: in units of its size.
        calm: 1 where the cycle may be learnt from.
    """
    beyond = ca.fmin(d.x**2 + ca.diag(d.P) - 1, LARGEST_STEP)
    for kind, part in zip(DRIVES, parts, strict=True):
        share = (part / (parts[0] + parts[1])) ** 2
        grown = fields.before[f"{kind}_level"] * (1 + period / LEARNT * calm * beyond * share)
        fields.following[f"{kind}_level"] = ca.fmin(ca.fmax(grown, _LEVELS[0]), _LEVELS[1])
