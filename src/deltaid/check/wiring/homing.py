"""A drive's zero or the direction of gravity: which of them explains what a recording leaves.

Both change torques in a way that has a column of its own, ∂(Y p)/∂q_0 and ∂(Y p)/∂g, beside those
of Y. Their values are a Gauss–Newton step; how far to trust it, the scatter of their scores between
blocks of time says, for noise of any colour.
"""

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
    """Errors of zeros [rad or m] and of the direction of gravity [rad], as rows tell them.

    Attributes:
        H: products of their columns, freed of what parameters explain.
        scores: of each block, (blocks, columns).
        left: sum of squares without them, freed likewise.
        rows: that it is of.
        drives: number of zeros; two angles of gravity follow, or none without gravity, then what
            else a drive may have: an offset of its torque, and a gain.
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

    @property
    def homing(self) -> list[int]:
        """Columns of zeros."""
        return list(range(self.drives))

    @cached_property
    def tilt(self) -> list[int]:
        """Columns of the direction of gravity that show."""
        both = range(self.drives, self.drives + self.angles)
        most = max((self.H[i, i] for i in both), default=0.0)
        return [i for i in both if self.H[i, i] > _SHOWN * most]  # a plane shows one angle

    @cached_property
    def offsets(self) -> list[int]:
        """Columns of constant torques."""
        first = self.drives + self.angles
        return list(range(first, first + self.drives))

    @cached_property
    def gains(self) -> list[int]:
        """Columns of gains; all together are the torques, so one must be left out then."""
        if self.drives == 1:
            return []
        return list(range(self.drives + self.angles + self.drives, len(self.H)))

    def told(
        self, which: list[int], beside: list[int] | None = None
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"]]:
        """Values of some columns and their covariance, with others free beside them."""
        at = [*which, *(beside or [])]
        H, n = self.H[np.ix_(at, at)], len(which)
        scale = 1 / np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        inverse = np.linalg.pinv(H * np.outer(scale, scale), rcond=1e-9) * np.outer(scale, scale)
        s = self.scores[:, at]
        value = inverse @ s.sum(axis=0)
        centred = s - s.mean(axis=0)
        blocks = len(s)
        spread = centred.T @ centred * blocks / max(blocks - len(at), 1)
        covariance = inverse @ spread @ inverse
        return value[:n], covariance[:n, :n]

    def certainty(self, which: list[int], beside: list[int] | None = None) -> float:
        """Wald's distance of some columns from zero, a number of standard deviations each."""
        value, covariance = self.told(which, beside)
        values, vectors = np.linalg.eigh(covariance)
        sure = values > 1e-9 * values[-1]
        projected = vectors[:, sure].T @ value
        return float(np.sqrt(np.sum(projected**2 / values[sure]) / max(len(which), 1)))

    def gain(self, which: list[int]) -> float:
        """Share of what is left that these columns explain."""
        H, s = self.H[np.ix_(which, which)], self.scores[:, which].sum(axis=0)
        return float(s @ np.linalg.pinv(H, rcond=1e-9, hermitian=True) @ s / self.left)


def shifts(dynamics: Dynamics, motion: Motion, best: Candidate) -> Shifts:
    """What a recording says about zeros and gravity, the rest being as a candidate has it."""
    found = best.residual
    dof = dynamics.dof
    tau = found.torques(best.order, best.gains)
    p = _parameters(dynamics, best, tau)
    D = _columns(dynamics, motion, best, p)
    angles = len(D) - dof
    D = np.concatenate([D, _others(dof, motion, best)])
    D = (D[:, :, found.keep] * found.weights[:, None]).reshape(len(D), -1)
    return Shifts.of(found.span, D.T, tau, dof, angles)


def _parameters(
    dynamics: Dynamics, best: Candidate, tau: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " parameters"]:
    """All parameters: from the prior as far as the torques ask for it."""
    found = best.residual
    prior = prior_parameters(dynamics.robot)
    scale = np.array([one.scale for one in dynamics.layout.parameters])[found.columns]
    noise = best.left * np.linalg.norm(tau) / np.sqrt(len(tau))
    A = np.vstack([found.Y / noise, np.diag(1.0 / (_SPREAD * scale))])
    b = np.append((tau - found.Y @ prior[found.columns]) / noise, np.zeros(len(scale)))
    prior[found.columns] += Span.of(A).coefficients(b)
    return prior


def _columns(
    dynamics: Dynamics, motion: Motion, best: Candidate, p: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, "columns drives kept"]:
    """Slopes of the torques at the kept samples; they are smooth enough to need no filter."""
    low_pass, map, dof = motion.low_pass, best.map, dynamics.dof
    at = low_pass.half + low_pass.decimation * np.arange(len(motion.tau))
    q = map.values(motion.q[at])
    qd, qdd = map.rates(motion.qd[at]), map.rates(motion.qdd[at])
    p = p.copy()
    p[dynamics.layout.friction] = 0.0  # its steps have no slope

    def torque(q: np.ndarray) -> np.ndarray:
        z, good = dynamics.kinematics.forward_unchecked(q)
        z = np.where(good[:, None], z, dynamics.kinematics.home)
        return np.where(good[:, None], dynamics.torque(z, qd, qdd, p), 0.0)

    slopes = []
    for i in range(dof):
        step = _STEP * np.eye(dof)[i]
        slopes.append((torque(q + step) - torque(q - step)).T / (2 * _STEP))
    z = best.residual.poses.z[at]
    moments = _moments(dynamics, z, p)  # ∂(Σ m r)/∂q
    g = np.array(dynamics.robot.gravity)
    slopes += [-np.einsum("k,skd->ds", np.cross(axis, g), moments) for axis in across(g)]
    return np.stack(slopes)


def _others(dof: int, motion: Motion, best: Candidate) -> Float[np.ndarray, "columns drives kept"]:
    """Offsets and gains of all drives."""
    tau = best.gains[:, None] * motion.tau.T[list(best.order)]
    offsets, gains = np.zeros((2, dof, *tau.shape))
    at = np.arange(dof)
    offsets[at, at], gains[at, at] = 1.0, tau
    return np.concatenate([offsets, gains])


def _moments(
    dynamics: Dynamics, z: Float[np.ndarray, "samples dof"], p: Float[np.ndarray, " parameters"]
) -> Float[np.ndarray, "samples 3 dof"]:
    """∂(Σ m r)/∂q, by differences along z and ∂z/∂q."""
    kinematics, layout = dynamics.kinematics, dynamics.layout
    counts = [body.count for body in kinematics.mechanism.bodies]

    def moment(z: np.ndarray) -> np.ndarray:
        total = np.zeros((len(z), 3))
        for body, count in zip(kinematics.poses(z), counts, strict=True):
            own = p[layout.body(body.name)]
            total += count * (own[0] * body.r_WB + body.R_WB @ own[1:4])
        return total

    along = [
        (moment(z + step) - moment(z - step)) / (2 * _STEP) for step in _STEP * np.eye(dynamics.dof)
    ]
    J = kinematics.jacobian(z)
    return np.linalg.solve(J.swapaxes(1, 2), np.stack(along, axis=1)).swapaxes(1, 2)
