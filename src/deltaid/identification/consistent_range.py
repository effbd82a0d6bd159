"""Ranges of parameters by the recording and physical consistency alone, without prior.

The range of c·p is its least and largest value over all consistent x, p = A x + p_0, with

    ‖R x − b‖² ≤ m² + t² ,

R and b the rows of data in units of the noise behind this very combination, judged by the scatter
of the recording as for all intervals (`scatter`), m² the least left side over consistent x, and t
Student's quantile. Where the recording determines c·p, this is the 95 % interval of least squares;
where it shows only a sum of c·p with something else, the other's prior has no part in it.

With R = U S Vᵀ and x = V_1 S⁻¹ (v + U_1ᵀb) + V_2 a, the data is a ball ‖v‖ ≤ r and what it does not
determine is a, free but for the cones: a linear function over a ball and cones (Clarabel).

Shares of the squared width: what stays when noise and geometry all but vanish is what the recording
does not show, and the rest parts as their variances.
"""

from dataclasses import replace
from functools import cached_property

import clarabel
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from deltaid.estimation.conic import definite, quiet_settings, svec
from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.free_body import Block
from deltaid.estimation.scatter import half_width, quantile
from deltaid.identification.fit import FittedProblem
from deltaid.identification.uncertainty import Sources
from deltaid.model.parameter_record import Share

# A singular value below this share of the largest is not identifiable.
_DEPENDENT = 1e-9
# Of the solver, for gap and feasibility.
_TOLERANCE = 1e-8
# Where cones touch the ball, the solver's ends are as good as the root of its tolerance: a range is
# made longer by this share at both ends.
_ACCURACY = 1e-3
# Share of t with which noise and geometry have all but vanished.
_VANISHED = 1e-2
_SOLVED = ("Solved", "AlmostSolved")

Vector = Float[np.ndarray, " n"]
Coefficients = Float[np.ndarray, " parameters"]


class ConsistentRanges:
    """Ranges of combinations c·p in a fit, of whose regulariser nothing is used."""

    def __init__(self, problem: FittedProblem) -> None:
        data, base, information = problem.objective.data, problem.base, problem.information
        self._reduction, self._noise = problem.reduction, problem.estimate.noise
        self._sources = Sources(information, base, self._noise)
        self._white = max(self._noise.sigma, NOISE_FLOOR)
        rows = np.sqrt(information.mean_samples) / self._white
        R, b = rows * data.R, rows * data.b
        size = np.linalg.norm(R, axis=0)
        scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), self._reduction.scale)
        U, S, Vt = np.linalg.svd(R * scale)
        self._rank = rank = int(np.sum(S / S[0] > _DEPENDENT))
        # x = centre + map (v, a)
        determined = Vt[:rank].T / S[:rank]
        self._map = scale[:, None] * np.hstack([determined, Vt[rank:].T])
        self._centre = scale * (determined @ (U[:, :rank].T @ b))
        combination = base.combination() @ self._reduction.A
        self._scores = self._noise.root @ combination @ self._map[:, :rank]
        self._shifts = self._noise.root @ problem.shifts
        # Rows of the ball, the first for its radius, and of the cones.
        ball = np.eye(rank + 1, self._map.shape[1], -1)
        parts = [(-ball, np.zeros(rank + 1), clarabel.SecondOrderConeT(rank + 1))]
        cones = (self._cone(block, size > 0) for block in self._reduction.blocks)
        parts += [cone for cone in cones if cone is not None]
        rows, right, self._cones = zip(*parts, strict=True)
        self._rows, self._right = np.concatenate(rows), np.concatenate(right)

    def ends(self, c: Coefficients) -> tuple[float, float]:
        """Least and largest c·p; infinite where neither recording nor consistency ends it."""
        c_x = self._reduction.A.T @ c
        cost = self._map.T @ c_x
        middle = float(c_x @ self._centre + c @ self._reduction.p_0)
        low, high = self._ends(cost, self._reach(cost)[0])
        more = _ACCURACY * max(high - low, 0.0) if np.isfinite(high - low) else 0.0
        return middle + low - more, middle + high + more

    def share(self, c: Coefficients, low: float, high: float) -> Share:
        """What the range of c·p, which must end, comes from."""
        cost = self._map.T @ (self._reduction.A.T @ c)
        t, by_noise = self._reach(cost)
        width = (high - low) / (1.0 + 2.0 * _ACCURACY)
        vanished = float(np.ptp(self._ends(cost, _VANISHED * t)))
        ratio = vanished / width if width > 0 else 0.0
        unseen = float(np.clip((ratio**2 - _VANISHED**2) / (1 - _VANISHED**2), 0.0, 1.0))
        parts = np.array(self._sources.parts(self._in_scores(cost)))[:, 0]
        noise, sensors, measured = ((1 - unseen) * by_noise * parts).tolist()
        return Share(
            noise=noise,
            prior=0.0,
            geometry=(1 - unseen) * (1 - by_noise),
            unseen=unseen,
            sensors=sensors,
            measured=measured,
        )

    def _in_scores(self, cost: Vector) -> Float[np.ndarray, "base 1"]:
        return (self._scores @ cost[: self._rank])[:, None]

    def _reach(self, cost: Vector) -> tuple[float, float]:
        """t, in units of white noise: scatter and geometry make a combination more uncertain; and
        the share of noise in its variance."""
        U = self._in_scores(cost)
        size = float(np.linalg.norm(U))
        if size == 0:
            return float(quantile(np.array([self._noise.freedom]))[0]), 1.0
        by_noise, nu = self._noise.deviations(U)
        std = np.hypot(by_noise, np.linalg.norm(U.T @ self._shifts))
        t = half_width(std, by_noise, nu)[0] / (self._white * size)
        return float(t), float((by_noise[0] / std[0]) ** 2) if std[0] > 0 else 1.0

    def _ends(self, cost: Vector, t: float) -> tuple[float, float]:
        """Least and largest cost·(v, a); infinite where there is none."""
        size, radius = float(np.linalg.norm(cost)), float(np.hypot(self._least, t))
        if size == 0:
            return 0.0, 0.0
        ends = [self._solve(sign * cost / size, self._rows, radius) for sign in (1.0, -1.0)]
        low, high = (
            size * float(end.obj_val) if str(end.status) in _SOLVED else -np.inf for end in ends
        )
        return low, -high

    @cached_property
    def _least(self) -> float:
        """m, the distance of the consistent x from the least-squares values of the recording."""
        wide = np.pad(self._rows, ((0, 0), (0, 1)))
        wide[0, -1] = -1.0
        return float(self._solve(np.eye(wide.shape[1])[-1], wide, 0.0).obj_val)

    def _solve(
        self, cost: Vector, rows: Float[np.ndarray, "rows n"], radius: float
    ) -> clarabel.DefaultSolution:
        right = self._right.copy()
        right[0] = radius
        nothing, settings = sparse.csc_matrix((len(cost), len(cost))), quiet_settings(_TOLERANCE)
        matrix, cones = sparse.csc_matrix(rows), list(self._cones)
        return clarabel.DefaultSolver(nothing, cost, matrix, right, cones, settings).solve()

    def _cone(
        self, block: Block, determined: Bool[np.ndarray, " n"]
    ) -> tuple[np.ndarray, np.ndarray, object] | None:
        """Rows, right side and cone of M_b(x) ⪰ 0, seen from its prior.

        A moment that the recording does not show can always be made large enough, so its row is
        excluded.
        """
        diagonal = np.diag(block.index)
        inner = np.ix_(*[np.flatnonzero((diagonal < 0) | determined[diagonal])] * 2)
        if np.all(block.index[inner] < 0):
            return None
        M = block.matrix(self._centre)
        part = replace(block, index=block.index[inner], constant=M[inner], prior=block.prior[inner])
        columns, at_centre, slopes = part.normalised
        rows, right = -svec(slopes).T @ self._map[columns], svec(at_centre)
        size = max(float(np.abs(rows).max()), float(np.abs(right).max()))
        return rows / size, right / size, definite(len(at_centre))
