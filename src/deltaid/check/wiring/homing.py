"""A drive's zero or the direction of gravity: which of them explains a residual.

Both have columns, ∂(Y p)/∂q_0 and ∂(Y p)/∂g, in addition to those of Y. Their values are a
Gauss–Newton step; its covariance follows from the scatter of scores between blocks of time, for
noise of any colour.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from deltaid.check.wiring.candidate import Candidate
from deltaid.check.wiring.motion import Motion
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.geometry import across
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.span import Span

# Blocks of time, step of the slopes [rad or m], and spread of the prior.
BLOCKS, _STEP, _SPREAD = 24, 1e-4, 0.5
# Share of the larger one's square below which an angle of gravity does not show.
_SHOWN = 1e-6


@dataclass(frozen=True, eq=False)
class Shifts:
    """Errors of zeros [rad or m] and of the direction of gravity [rad], from rows.

    Attributes:
        H: products of their columns, parameters projected out.
        scores: of each block, (blocks, columns).
        left: sum of squares without them, parameters projected out.
        rows: that it is of.
        drives: number of zeros; two angles of gravity follow, or none without gravity, then each
            drive's torque offset and gain.
        angles: 2, or 0.
    """

    H: Float[np.ndarray, "columns columns"]
    scores: Float[np.ndarray, "blocks columns"]
    left: float
    rows: int
    drives: int
    angles: int

    @classmethod
    def of(
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

    def told(
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
        value, covariance = self.told(chosen, beside)
        values, vectors = np.linalg.eigh(covariance)
        determined = values > 1e-9 * values[-1]
        projected = vectors[:, determined].T @ value
        return float(np.sqrt(np.sum(projected**2 / values[determined]) / max(len(chosen), 1)))

    def gain(self, chosen: list[int]) -> float:
        """Share of the residual that these columns explain."""
        H, s = self.H[np.ix_(chosen, chosen)], self.scores[:, chosen].sum(axis=0)
        return float(s @ np.linalg.pinv(H, rcond=1e-9, hermitian=True) @ s / self.left)


def shifts(dynamics: Dynamics, motion: Motion, best: Candidate) -> Shifts:
    """Errors of zeros and gravity in a recording, for the columns of a candidate."""
    residual, dof, tau = best.residual, dynamics.dof, best.torques
    # All parameters: the prior, moved as far as the torques require.
    p = prior_parameters(dynamics.robot)
    noise = np.linalg.norm(residual.span.without(tau)) / np.sqrt(len(tau))
    A = np.vstack([residual.Y / noise, np.diag(1.0 / (_SPREAD * residual.scale))])
    b = np.append((tau - residual.Y @ residual.prior) / noise, np.zeros(A.shape[1]))
    p[residual.columns] += Span.of(A).coefficients(b)
    slopes = _slopes(dynamics, motion, best, p)[:, residual.keep]
    offsets = residual.rows.own(np.ones((dof, len(residual.tau))))
    D = np.hstack([residual.rows.stack(slopes), offsets, best.columns * best.gains])
    return Shifts.of(residual.span, D, tau, dof, slopes.shape[2] - dof)


def _slopes(
    dynamics: Dynamics, motion: Motion, best: Candidate, p: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, "drives kept columns"]:
    """Slopes of the torques at the kept samples; they are smooth enough to need no filter."""
    low_pass, map, kinematics = motion.low_pass, best.map, dynamics.kinematics
    places = low_pass.half + low_pass.decimation * np.arange(len(motion.tau))
    q = map.values(motion.q[places])
    qd, qdd = map.rates(motion.qd[places]), map.rates(motion.qdd[places])
    p = p.copy()
    p[dynamics.layout.friction] = 0.0  # its steps have no slope

    def torque(q: np.ndarray) -> np.ndarray:
        z, good = kinematics.forward_unchecked(q)
        z = np.where(good[:, None], z, kinematics.home)
        return np.where(good[:, None], dynamics.torque(z, qd, qdd, p), 0.0)

    def moment(z: np.ndarray) -> np.ndarray:
        total = np.zeros((len(z), 3))
        for pose, body in zip(kinematics.poses(z), kinematics.mechanism.bodies, strict=True):
            m = p[dynamics.layout.body(pose.name)]
            total += body.count * (m[0] * pose.r_WB + pose.R_WB @ m[1:4])
        return total

    z, g = best.residual.z[places], np.array(dynamics.robot.gravity)
    J, along = kinematics.jacobian(z), _differences(moment, z)
    moments = np.linalg.solve(J.swapaxes(1, 2), along.swapaxes(1, 2)).swapaxes(1, 2)
    tilts = [-np.einsum("k,skd->ds", np.cross(axis, g), moments) for axis in across(g)]
    zeros = _differences(torque, q).swapaxes(0, 1)
    return np.concatenate([zeros, *(column[:, :, None] for column in tilts)], axis=2)


def _differences(
    f: Callable[[np.ndarray], np.ndarray], x: Float[np.ndarray, "samples dof"]
) -> Float[np.ndarray, "samples values dof"]:
    """Central differences of values of each sample."""
    steps = _STEP * np.eye(x.shape[1])
    return np.stack([(f(x + step) - f(x - step)) / (2 * _STEP) for step in steps], axis=-1)
