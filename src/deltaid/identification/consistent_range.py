"""How far a parameter may lie when only the recording and physical consistency speak, no prior.

The range of c·p is its least and largest value over all consistent x, p = A x + p_0, with

    ‖R x − b‖² ≤ m² + t² ,

R and b the rows of data in units of the noise behind this very combination, judged by the scatter
of the recording as for all intervals (`scatter`), m² the least left side over consistent x, and t
Student's quantile. Where the recording determines c·p, this is the 95 % interval of least squares;
where it shows only a sum of c·p with something else, the other's prior has no part in it.

With R = U S Vᵀ and x = V_1 S⁻¹ (v + U_1ᵀb) + V_2 a, the data is a ball ‖v‖ ≤ r and what it does not
show is a, free but for the cones: a linear function over a ball and cones (Clarabel).

What a range comes from is told in shares of its squared width: that which stays when noise and
geometry all but vanish is what the recording does not show, and the rest parts as their variances.
"""

from functools import cached_property
from typing import NamedTuple

import clarabel
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.conic import normalised, svec
from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.free_body import Block
from deltaid.estimation.information import Information
from deltaid.estimation.objective import Objective
from deltaid.estimation.scatter import Noise, half_width, quantile
from deltaid.identification.sources import Sources
from deltaid.model.parameter_record import Share

# A singular value below this share of the largest is what the recording does not show.
_DEPENDENT = 1e-9
_TOLERANCE = 1e-8
# Where cones touch the ball, the solver's ends are as good as the root of its tolerance: a range is
# made longer by this share at both ends.
_ACCURACY = 1e-3
# Share of t with which noise and geometry have all but vanished.
_VANISHED = 1e-2
_SOLVED = ("Solved", "AlmostSolved")

Vector = Float[np.ndarray, " n"]
Coefficients = Float[np.ndarray, " parameters"]


class Range(NamedTuple):
    """Least and largest value; infinite where neither recording nor consistency ends it."""

    low: float
    high: float


class _Reach(NamedTuple):
    """t, in units of white noise: scatter and geometry make a combination more uncertain; and the
    share of noise in its variance."""

    t: float
    noise: float


class ConsistentRanges:
    """Ranges of combinations c·p in a fit.

    Args:
        objective: of the fit; of its regulariser nothing is used.
        base: which combinations of parameters the recording determines.
        noise: behind their least-squares values.
        shifts: of these values by one standard deviation of each length, zero and mounting.
    """

    def __init__(
        self,
        objective: Objective,
        information: Information,
        base: BaseParameters,
        noise: Noise,
        shifts: Float[np.ndarray, "base quantities"] | None = None,
    ) -> None:
        self._reduction, self._noise = objective.reduction, noise
        self._sources = Sources.of(information, base, noise)
        self._white = max(noise.sigma, NOISE_FLOOR)
        rows = np.sqrt(information.mean_samples) / self._white
        R, b = rows * objective.data.R, rows * objective.data.b
        size = np.linalg.norm(R, axis=0)
        self._scale = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), self._reduction.scale)
        U, S, Vt = np.linalg.svd(R * self._scale)
        rank = int(np.sum(S / S[0] > _DEPENDENT))
        # x = centre + map (v, a)
        shown = Vt[:rank].T / S[:rank]
        self._rank, self._map = rank, self._scale[:, None] * np.hstack([shown, Vt[rank:].T])
        self._centre = self._scale * (shown @ (U[:, :rank].T @ b))
        combination = base.combination() @ self._reduction.A
        self._scores = noise.root @ combination @ self._map[:, :rank]
        self._shifts = noise.root @ (np.zeros((base.rank, 0)) if shifts is None else shifts)
        cones = (self._cone(block, size > 0) for block in self._reduction.blocks)
        self._cones = [cone for cone in cones if cone is not None]

    def of(self, c: Coefficients) -> Range:
        """The range of c·p."""
        c_x = self._reduction.A.T @ c
        cost = self._map.T @ c_x
        middle = float(c_x @ self._centre + c @ self._reduction.p_0)
        low, high = self._ends(cost, self._reach(cost[: self._rank]).t)
        more = _ACCURACY * max(high - low, 0.0) if np.isfinite(high - low) else 0.0
        return Range(middle + low - more, middle + high + more)

    def share(self, c: Coefficients, within: Range) -> Share:
        """What the range of c·p, which must end, comes from."""
        cost = self._map.T @ (self._reduction.A.T @ c)
        reach = self._reach(cost[: self._rank])
        whole = (within.high - within.low) / (1.0 + 2.0 * _ACCURACY)
        rest = float(np.ptp(self._ends(cost, _VANISHED * reach.t)))
        ratio = float(rest / whole) if whole > 0 else 0.0
        unseen = float(np.clip((ratio**2 - _VANISHED**2) / (1 - _VANISHED**2), 0.0, 1.0))
        noise, geometry = (1 - unseen) * reach.noise, (1 - unseen) * (1 - reach.noise)
        U = (self._scores @ cost[: self._rank])[:, None]
        torques, sensors, measured = (float(part[0]) for part in self._sources.parts(U))
        return Share(
            noise=noise * torques,
            prior=0.0,
            geometry=geometry,
            unseen=unseen,
            sensors=noise * sensors,
            measured=noise * measured,
        )

    def _ends(self, cost: Vector, t: float) -> tuple[float, float]:
        """Least and largest cost·(v, a)."""
        radius = float(np.hypot(self._least, t))
        return self._extreme(cost, radius), -self._extreme(-cost, radius)

    def _reach(self, shown: Vector) -> _Reach:
        """How far v may be off along a combination of it."""
        U = (self._scores @ shown)[:, None]
        size = float(np.linalg.norm(U))
        if size == 0:
            return _Reach(float(quantile(np.array([self._noise.freedom]))[0]), 1.0)
        by_noise, nu = self._noise.deviations(U)
        std = np.hypot(by_noise, np.linalg.norm(U.T @ self._shifts))
        t = half_width(std, by_noise, nu)[0] / (self._white * size)
        return _Reach(float(t), float((by_noise[0] / std[0]) ** 2) if std[0] > 0 else 1.0)

    @cached_property
    def _least(self) -> float:
        """m, the distance of the consistent x from the least-squares values of the recording."""
        n = self._map.shape[1]
        wide = np.hstack([self._rows, np.zeros((len(self._rows), 1))])
        wide[0, n] = -1.0
        return float(self._solve(np.append(np.zeros(n), 1.0), sparse.csc_matrix(wide), 0.0).obj_val)

    def _extreme(self, cost: Vector, radius: float) -> float:
        """The least cost·(v, a) with ‖v‖ ≤ radius; −∞ if there is none."""
        size = float(np.linalg.norm(cost))
        if size == 0:
            return 0.0
        solution = self._solve(cost / size, self._matrix, radius)
        return size * float(solution.obj_val) if str(solution.status) in _SOLVED else -np.inf

    @cached_property
    def _rows(self) -> Float[np.ndarray, "rows n"]:
        """Rows of the ball, the first for its radius, and of the cones."""
        ball = np.zeros((self._rank + 1, self._map.shape[1]))
        ball[1:, : self._rank] = -np.eye(self._rank)
        return np.vstack([ball, *(rows for rows, _, _ in self._cones)])

    @cached_property
    def _matrix(self) -> sparse.csc_matrix:
        return sparse.csc_matrix(self._rows)

    def _cone(
        self, block: Block, shown: Bool[np.ndarray, " n"]
    ) -> tuple[np.ndarray, np.ndarray, object] | None:
        """Rows, right side and cone of M_b(x) ⪰ 0, seen from its prior.

        A moment that the recording does not show can always be made large enough, so its row is
        left out.
        """
        own = np.diag(block.index)
        rest = np.flatnonzero((own < 0) | shown[own])
        index = block.index[np.ix_(rest, rest)]
        if np.all(index < 0):
            return None
        prior, M = (x[np.ix_(rest, rest)] for x in (block.prior, block.matrix(self._centre)))
        at = np.unique(index[index >= 0])
        slopes = np.column_stack([svec(normalised(prior, (index == k).astype(float))) for k in at])
        right, k = svec(normalised(prior, M)), len(rest)
        cone = clarabel.NonnegativeConeT(1) if k == 1 else clarabel.PSDTriangleConeT(k)
        rows = -slopes @ self._map[at]
        size = max(float(np.abs(rows).max()), float(np.abs(right).max()))
        return rows / size, right / size, cone

    def _solve(
        self, cost: Vector, matrix: sparse.csc_matrix, radius: float
    ) -> clarabel.DefaultSolution:
        ball = np.append(radius, np.zeros(self._rank))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix((len(cost), len(cost))),
            cost,
            matrix,
            np.concatenate([ball, *(right for _, right, _ in self._cones)]),
            [clarabel.SecondOrderConeT(len(ball)), *(cone for _, _, cone in self._cones)],
            settings,
        )
        return solver.solve()
