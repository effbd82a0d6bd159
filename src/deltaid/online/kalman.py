"""Kalman's filter in covariance form, written out: constants, and what wanders about zero.

States are in units of their prior, whose covariance is the identity. From cycle to cycle state i
forgets: its covariance goes back to the prior's,

    P ← D P D + (1 − D²),   D = diag(φ),

so it stays between zero and the prior however long nothing is told (no wind-up), and positive
semidefinite. What is measured is taken one number after the other, without a matrix to invert.

How large the torques are that a model has not is learnt. They are d, one number a drive, of the
size

    a + b / (1 + (q̇/v)²),

a while the drive moves and b more where it is slow. In units of that size E(d²) = 1, so d² + P_dd
beyond 1 says that a and b are larger than thought, below 1 that they are smaller; each learns by
its share.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.online.graph import CycleFields, Field

# Memory [s] of a load, of the model's own errors, and of torques that the model has not.
_LOAD, _MODEL, _UNMODELLED = 1e6, 300.0, 0.05


@dataclass(frozen=True, eq=False)
class Update:
    """What one measured number does: its row h of the states, what it is beyond what was expected
    with its variance, the gain by which states move, and 0 where it counts for nothing."""

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
        """Of some of the states."""
        return Estimate(self.x[which], self.P[which, which])

    def forgotten(self, kept: ca.SX, prior: ca.SX, wanders: ca.SX) -> "Estimate":
        """A cycle later.

        Args:
            kept: φ of each state.
            prior: variance that each goes back to.
            wanders: 1 where the mean goes back to zero too, 0 where it stays.
        """
        P = self.P * (kept @ kept.T) + ca.diag(prior * (1 - kept * kept))
        return Estimate(self.x * (1 - wanders * (1 - kept)), P)

    def measured(
        self, row: ca.SX, value: ca.SX, variance: ca.SX, weight: ca.SX
    ) -> tuple["Estimate", Update]:
        """With one number known, value = row·x and noise of this variance.

        Args:
            weight: share of its information that is taken, 0 for none.
        """
        moves, innovation = self.P @ row.T, value - row @ self.x
        total = (row @ moves) * weight + variance
        gain = moves * weight / total
        P = ca.tril2symm(ca.tril(self.P - gain @ moves.T))
        update = Update(row, innovation * weight, total, gain, weight)
        return Estimate(self.x + gain * innovation, P), update


class States:
    """What is estimated, and how long it is remembered.

    Attributes:
        stays: share of each that is not forgotten in a cycle.
        wander: 1 for those whose mean is forgotten too.

    Args:
        kinds: of each: 0 load, 1 model, 2 friction, 3 unmodelled.
        period, friction_time: [s].
    """

    def __init__(self, kinds: np.ndarray, period: float, friction_time: float) -> None:
        self._loads, self.wander = kinds == 0, ca.SX((kinds == 3).astype(float))
        memory = np.array([_LOAD, _MODEL, friction_time, _UNMODELLED])[kinds]
        self.stays = ca.SX(np.exp(-period / memory))

    def before(self, fields: CycleFields) -> Estimate:
        """As the cycle before left them."""
        n, initial = len(self._loads), np.diag(np.where(self._loads, 0.0, 1.0))
        first = tuple(initial[np.triu_indices(n)].tolist())
        x, P = fields.keep(
            Field("x", n, "estimate, in deviations of its prior"),
            Field("P", len(first), "its covariance, columns of the lower triangle", initial=first),
        )
        return Estimate(x, ca.tril2symm(ca.SX(ca.Sparsity.lower(n), P)))

    def later(self, estimate: Estimate, held: ca.SX) -> Estimate:
        """A cycle later, before anything is measured.

        Args:
            held: 1 while a load was held.
        """
        prior = ca.vertcat(*(held if is_load else ca.SX(1) for is_load in self._loads))
        return estimate.forgotten(self.stays, prior, self.wander)


# How fast [s] sizes are learnt, within which bounds, and the most by which one cycle counts.
_LEARNT, _LEVELS, _LARGEST_STEP = 2.0, (0.15, 20.0), 10.0
# Drives whose sizes are learnt apart, in units of what was thought.
DRIVES = ("moving", "slow")


def learn_levels(
    fields: CycleFields, parts: tuple[ca.SX, ca.SX], d: Estimate, calm: ca.SX, period: float
) -> None:
    """What the sizes become.

    Args:
        parts: a and what b adds.
        d: in units of its size.
        calm: 1 where it may be learnt from.
    """
    beyond = ca.fmin(d.x**2 + ca.diag(d.P) - 1, _LARGEST_STEP)
    for kind, part in zip(DRIVES, parts, strict=True):
        share = (part / (parts[0] + parts[1])) ** 2
        grown = fields.before[f"{kind}_level"] * (1 + period / _LEARNT * calm * beyond * share)
        fields.following[f"{kind}_level"] = ca.fmin(ca.fmax(grown, _LEVELS[0]), _LEVELS[1])
