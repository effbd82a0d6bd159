"""A drive's zero or the direction of gravity: which of them explains a residual.

Both have columns, ∂(Y p)/∂q_0 and ∂(Y p)/∂g, in addition to those of Y. Their values are a
Gauss–Newton step; its covariance follows from the scatter of scores between blocks of time, for
noise of any colour.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from deltaid.checks.wiring.candidate import WiringHypothesis
from deltaid.checks.wiring.motion import FilteredMotion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.geometry import across, torque_slopes
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.problem import LinearProblem, Span

# Blocks of time, and spread of the prior.
BLOCKS, _SPREAD = 24, 0.5
# Share of the larger one's square below which an angle of gravity does not show.
_SHOWN = 1e-6


@dataclass(frozen=True, eq=False)
class Shifts:
    """Errors of zeros [rad or m] and of the direction of gravity [rad], from rows.

    Columns are of the drives' zeros, of two angles of gravity or none without gravity, then of each
    drive's torque offset and gain.
    """

    H: Float[np.ndarray, "columns columns"]  # products of columns, parameters projected out
    scores: Float[np.ndarray, "blocks columns"]
    left: float  # sum of squares without the columns, parameters projected out
    rows: int  # that it is of
    drives: int
    angles: int  # of gravity, 2 or 0

    @classmethod
    def from_rows(
        cls,
        span: Span,
        D: Float[np.ndarray, "rows columns"],
        tau: Float[np.ndarray, " rows"],
        drives: int,
        angles: int,
    ) -> "Shifts":
        """From columns and torques as rows of drives under each other, and what explains them."""
        D, e = span.without(D), span.without(tau)
        count = len(e) // drives
        edges = np.linspace(0, count, BLOCKS + 1).astype(int)
        products = (D * e[:, None]).reshape(drives, count, -1).sum(axis=0)
        scores = np.stack([products[a:b].sum(axis=0) for a, b in pairwise(edges)])
        return cls(D.T @ D, scores, float(e @ e), len(e), drives, angles)

    @cached_property
    def tilt(self) -> list[int]:
        """Columns of the direction of gravity that show."""
        angles = range(self.drives, self.drives + self.angles)
        largest = max((self.H[i, i] for i in angles), default=0.0)
        return [i for i in angles if self.H[i, i] > _SHOWN * largest]  # a plane shows one angle

    @property
    def offsets(self) -> list[int]:
        first = self.drives + self.angles
        return list(range(first, first + self.drives))

    @property
    def gains(self) -> list[int]:
        """Columns of gains; together they are the torques, so one must be excluded then."""
        first = 2 * self.drives + self.angles
        return list(range(first, len(self.H))) if self.drives > 1 else []

    def estimate(
        self, chosen: list[int], beside: Sequence[int] = ()
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
        """Values of some columns and their covariance, with others free beside them."""
        columns = [*chosen, *beside]
        H, n = self.H[np.ix_(columns, columns)], len(chosen)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        inverse = np.linalg.pinv(H * np.outer(scale, scale), rcond=1e-9) * np.outer(scale, scale)
        s = self.scores[:, columns]
        centred, blocks = s - s.mean(axis=0), len(s)
        spread = centred.T @ centred * blocks / max(blocks - len(columns), 1)
        return (inverse @ s.sum(axis=0))[:n], (inverse @ spread @ inverse)[:n, :n]

    def certainty(self, chosen: list[int], beside: Sequence[int] = ()) -> float:
        """Wald's distance of some columns from zero in standard deviations; 0 if unobservable."""
        if not all(self.H[i, i] > 0 for i in chosen):
            return 0.0
        value, covariance = self.estimate(chosen, beside)
        values, vectors = np.linalg.eigh(covariance)
        determined = values > 1e-9 * values[-1]
        projected = vectors[:, determined].T @ value
        return float(np.sqrt(np.sum(projected**2 / values[determined]) / max(len(chosen), 1)))

    def gain(self, chosen: list[int]) -> float:
        """Share of the residual that these columns explain."""
        H, s = self.H[np.ix_(chosen, chosen)], self.scores[:, chosen].sum(axis=0)
        return float(s @ np.linalg.pinv(H, rcond=1e-9, hermitian=True) @ s / self.left)


def shifts(dynamics: Dynamics, motion: FilteredMotion, best: WiringHypothesis) -> Shifts:
    """Errors of zeros and gravity in a recording, for the columns of a candidate."""
    residual, dof, tau, g = best.residual, dynamics.dof, best.torques, dynamics.robot.gravity
    # All parameters: the prior, moved as far as the torques require.
    p = prior_parameters(dynamics.robot)
    noise = np.linalg.norm(residual.span.without(tau)) / np.sqrt(len(tau))
    Y, left = residual.Y / noise, (tau - residual.Y @ residual.prior) / noise
    known = np.diag(1.0 / (_SPREAD * residual.scale)), np.zeros(Y.shape[1])
    p[residual.columns] += LinearProblem(Y, left, residual.rows.groups).with_known(*known).x
    # Slopes at the kept samples are smooth enough to need no filter.
    kept, low_pass = np.flatnonzero(residual.keep), motion.low_pass
    places = low_pass.half + low_pass.decimation * kept
    qd, qdd = (best.map.rates(rate[places]) for rate in (motion.qd, motion.qdd))
    slopes, axes = torque_slopes(dynamics, residual.z[places], qd, qdd, p), across(np.array(g))
    D = np.stack([*map(slopes.of_zero, range(dof)), *map(slopes.of_gravity, axes)], axis=2)
    offsets = residual.rows.per_drive(np.ones((dof, len(kept))))
    columns = np.hstack([residual.rows.stack(D), offsets, best.columns * best.gains])
    return Shifts.from_rows(residual.span, columns, tau, dof, len(axes))
