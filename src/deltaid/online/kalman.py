"""Kalman's filter in covariance form, written out: constants, and what wanders about zero.

States are in units of their prior, whose covariance is the identity. From cycle to cycle state i
forgets: its covariance goes back to the prior's,

    P ← D P D + (1 − D²),   D = diag(φ),

so it stays between zero and the prior however long nothing is told (no wind-up), and positive
semidefinite. What is measured is taken one number after the other, without a matrix to invert.
"""

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, eq=False)
class Update:
    """What one measured number does.

    Attributes:
        row: h, what it shows of the states.
        innovation: what it is beyond what was expected.
        variance: of that.
        gain: by which states move with it.
        counts: 0 where it was taken for nothing.
    """

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
