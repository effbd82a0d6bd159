"""Kalman's filter in covariance form, written out: constants, and what wanders about zero.

States are in units of their prior, whose covariance is the identity. From cycle to cycle state i
forgets: its covariance goes back to the prior's,

    P ← D P D + (1 − D²),   D = diag(φ),

so it stays between zero and the prior however long nothing is told (no wind-up), and positive
semidefinite. What is measured is taken one number after the other, without a matrix to invert.
"""

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Estimate:
    """Mean x and symmetric covariance P of the states."""

    x: ca.SX
    P: ca.SX

    def forgotten(self, kept: ca.SX, prior: ca.SX, wanders: ca.SX) -> "Estimate":
        """A cycle later.

        Args:
            kept: φ of each state.
            prior: variance that each goes back to.
            wanders: 1 where the mean goes back to zero too, 0 where it stays.
        """
        P = self.P * (kept @ kept.T) + ca.diag(prior * (1 - kept * kept))
        return Estimate(self.x * (1 - wanders * (1 - kept)), P)

    def told(self, row: ca.SX, value: ca.SX, variance: ca.SX, weight: ca.SX) -> "Estimate":
        """With one number known, value = row·x and noise of this variance.

        Args:
            weight: share of its information that is taken, 0 for none.
        """
        moves = self.P @ row.T
        total = (row @ moves) * weight + variance
        gain = moves * (weight / total)
        P = self.P - gain @ moves.T
        return Estimate(self.x + gain * (value - row @ self.x), ca.tril2symm(ca.tril(P)))
