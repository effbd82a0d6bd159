"""One assignment of columns to drives, and the likelihood of a consistent robot under it,

    −2 log L = N log σ² + ‖W(E u − Y p)‖²/σ² + d²(p, p₀),   p in its cones,

with the entropic distance d² to the prior: with a wrong sign, only impossible masses could explain
the torques of a poor motion. W scales rows by each drive's recorded torque, so units do not matter.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import eigh

from deltaid.checks.evidence import UNRELATED
from deltaid.checks.wiring.residual import (
    AT_REST,
    FEWEST,
    LEAST,
    OFFSET,
    UNIT,
    FilteredMotion,
    Map,
    MapResidual,
    patterns,
    poses,
    residual,
    rms_torques,
)
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import IdentificationError
from deltaid.estimation.conic import Conic
from deltaid.estimation.objective import LOG_DET, Objective, Quadratic, Regularizer, regularizer
from deltaid.estimation.problem import Span
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.levels import FEW_ROUNDS, LEVEL
from deltaid.robot.description import RobotDescription

# Least share of samples whose loops close, in all samples and in the few that are tried first.
CLOSED, MOSTLY_CLOSED = 0.98, 0.9
# Largest residual share with which units need no search, and least correlations with the prior's
# torques, of drives that are tied to others and of loose ones.
LITTLE, ALONG, ALONG_LOOSE = 0.05, 0.85, 0.6
# Least correlation with the prior's torques and largest residual share of a plausible hypothesis,
# and of one with factors of positions.
SENSIBLE, _SENSIBLE_SCALED = (0.5, 0.5), (0.75, 0.25)
# Largest likelihood ratio per row and log likelihood ratio of equally good hypotheses: noise is not
# white, and no model exact. The latter is also the largest distance d² of a robot as described.
_AS_GOOD, _CERTAIN = 1.1, 10.0
_SOLVER = Conic(tolerance=1e-7, largest_gap=1e-2)
# Number of torque patterns per map that are judged, and of hypotheses fitted on all samples.
JUDGED = 6

# Possible units of position columns, by their factor to the joint's unit.
TURNING = {np.pi / 180: "degrees", 2 * np.pi: "revolutions", 180 / np.pi: "radians"}
SLIDING = {1e-3: "millimetres", 1e3: "metres"}

# A map of positions, the torque column of each drive, and gains of these.
Assignment = tuple[Map, tuple[int, ...], tuple[float, ...]]


@dataclass(frozen=True)
class Consistent:
    """The fit of a consistent robot."""

    score: float  # log likelihood plus log prior
    unexplained: float  # share of the torques, the same for each drive
    distance: float  # d² to the prior; below about 10 where bodies are as described


IMPOSSIBLE = Consistent(-np.inf, 1.0, np.inf)


@dataclass(frozen=True, eq=False)
class WiringHypothesis:
    """One assignment of columns, and the fit of a consistent robot under it."""

    residual: MapResidual
    order: tuple[int, ...]  # the torque column of each drive
    # drive torque = gain · number, with sign; ±1, or a gain far from 1
    gains: Float[np.ndarray, " drives"]
    evidence: float = 0.0  # log evidence without consistency, to choose which to fit

    @property
    def map(self) -> Map:
        return self.residual.map

    @property
    def key(self) -> Assignment:
        """The assignment, with rounded gains."""
        return self.map, self.order, tuple(np.round(self.gains, 3).tolist())

    @cached_property
    def columns(self) -> Float[np.ndarray, "rows drives"]:
        """The torque column of each drive, as weighted rows."""
        return self.residual.rows.per_drive(self.residual.tau[:, list(self.order)].T)

    @property
    def torques(self) -> Float[np.ndarray, " rows"]:
        return self.columns @ self.gains

    @cached_property
    def residual_products(self) -> Float[np.ndarray, "drives drives"]:
        """S: with free parameters, the gains u leave the residual uᵀS u."""
        rest = self.residual.span.without(self.columns)
        return rest.T @ rest

    @cached_property
    def _rows(self) -> Float[np.ndarray, "drives samples augmented"]:
        """[A b] of A x = b over a robot's free parameters, each drive as a share of its torques."""
        residual, tau = self.residual, (self.residual.tau[:, list(self.order)] * self.gains).T
        Y = residual.Y.reshape(*tau.shape, -1) * residual.rows.scale[:, None, None]
        weights = np.where(residual.still, AT_REST, 1.0)[:, None]
        by = np.linalg.norm(Y @ residual.prior * weights) / np.linalg.norm(tau * weights)
        by = 1.0 if abs(np.log(by)) < np.log(UNIT) else by
        reduction, _ = _prior(residual.dynamics, tuple(residual.columns.tolist()))
        A, p_0 = reduction.A[residual.columns], reduction.p_0[residual.columns]
        rows = np.concatenate([Y @ A, (by * tau - Y @ p_0)[:, :, None]], axis=2)
        return rows * (weights[:, 0] / (by * rms_torques(tau)))[:, None, None]

    @cached_property
    def fit(self) -> Consistent:
        rows, residual, noise, best = self._rows, self.residual, 0.02, IMPOSSIBLE
        mean, count = rows.mean(axis=1, keepdims=True), rows[:, :, 0].size
        reduction, regularizer = _prior(residual.dynamics, tuple(residual.columns.tolist()))
        for _ in range(FEW_ROUNDS):
            # A constant torque has a prior of the usual size of offsets.
            share = 1 - 1 / np.sqrt(1 + rows.shape[1] * (OFFSET / noise) ** 2)
            data = Quadratic.from_rows((rows - share * mean).reshape(count, -1) / noise)
            try:
                solution = _SOLVER.solve(Objective(reduction, data, regularizer, gamma=1.0))
            except IdentificationError:
                return IMPOSSIBLE
            misfit, before = data.evaluate(solution.x)[0], noise
            distance = solution.objective - misfit
            noise = float(np.sqrt(misfit * before**2 / count + LEAST**2))
            best = Consistent(float(-count * np.log(noise) - 0.5 * distance), noise, distance)
            if abs(np.log(noise / before)) < LEVEL:
                break
        return best

    @property
    def unexplained(self) -> float:
        """Residual share of the torques, raised by samples whose loops do not close."""
        return (1 + 3 * (1 - self.residual.share)) * self.fit.unexplained

    @cached_property
    def loose(self) -> Bool[np.ndarray, " drives"]:
        """Drives with an undetermined gain: their residual correlates with no other's. Limbs that
        share a platform correlate by 0.5 at least, a telescope's drive by 0.1 at most."""
        S = self.residual_products
        size = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
        return (np.abs(S / np.outer(size, size)) - np.eye(len(S))).max(axis=0) < UNRELATED

    @property
    def correlations(self) -> Float[np.ndarray, " drives"]:
        """Correlation of each drive's torque with that of the prior."""
        return (
            np.sign(self.gains) * self.residual.correlations[np.arange(len(self.order)), self.order]
        )

    @property
    def closes(self) -> bool:
        return self.residual.share >= CLOSED

    @property
    def clear(self) -> bool:
        """Whether units need no search."""
        near = self._correlates(ALONG, ALONG_LOOSE) and self.fit.distance < _CERTAIN
        return near and self.closes and self.unexplained < LITTLE

    @property
    def sensible(self) -> bool:
        """Whether torques correlate with the motion at all; for a loose drive the prior determines
        the sign."""
        along, largest = _SENSIBLE_SCALED if self.map.scaled else SENSIBLE
        return self._correlates(along, 0.0) and self.unexplained < largest

    def _correlates(self, tied: float, loose: float) -> bool:
        """Whether each moving drive's torque correlates enough with that of the prior."""
        return bool(
            np.all((self.correlations > np.where(self.loose, loose, tied))[~self.residual.still])
        )

    @property
    def changes(self) -> int:
        """Number of columns that differ from the mapping."""
        orders = (*enumerate(self.map.order), *enumerate(self.order))
        moved = sum(drive != column for drive, column in orders)
        return moved + _distinct(np.array(self.map.scale)) + _distinct(self.gains)

    @property
    def complexity(self) -> tuple[int, bool, bool]:
        """Sort key, the simplest first: columns that differ from the mapping, whether positions are
        in an unnamed unit, whether the map is not the identity."""
        unnamed = any(abs(f) not in (1, *TURNING, *SLIDING) for f in self.map.scale)
        return self.changes, unnamed, self.map != Map.identity(len(self.order))

    def beats(self, as_mapped: "WiringHypothesis") -> bool:
        """Whether its residual rules out the columns as mapped."""
        doubted = as_mapped.unexplained < 2 * self.unexplained
        return self is as_mapped or not (doubted or as_mapped.as_likely_as(self))

    def as_likely_as(self, best: "WiringHypothesis") -> bool:
        """Whether noise or model errors explain the difference to the best."""
        return best.fit.score - self.fit.score < as_good(len(best.residual.Y))


def as_good(rows: int) -> float:
    """Insignificant difference of log likelihoods of so many rows."""
    return max(_CERTAIN, rows * float(np.log(_AS_GOOD)))


def _distinct(factors: Float[np.ndarray, " drives"]) -> int:
    """Number of drives with a factor; 1 if all have the same."""
    odd = int(np.sum(factors != 1))
    return 1 if odd == len(factors) and np.ptp(factors) == 0 else odd


def named_units(robot: RobotDescription, drive: int) -> dict[float, str]:
    """Units that a drive's positions may be in, by factor."""
    return SLIDING if robot.is_linear(robot.drives[drive]) else TURNING


@lru_cache(maxsize=8)
def _prior(dynamics: Dynamics, columns: tuple[int, ...]) -> tuple[Reduction, Regularizer]:
    """Reduction and regularizer of all hypotheses about columns."""
    reduction = build_reduction(dynamics.robot, np.array(columns))
    return reduction, regularizer(reduction, LOG_DET)


def closed_shares(
    dynamics: Dynamics, motion: FilteredMotion, maps: Sequence[Map]
) -> Float[np.ndarray, " maps"]:
    """Share of samples whose loops close under each map, estimated from a few."""
    chosen = np.linspace(0, len(motion.q) - 1, FEWEST).astype(int)
    few = motion.q[chosen]
    q = np.reshape([map.values(few) for map in maps], (len(maps), *few.shape))
    return poses(dynamics, q)[1].mean(axis=1)


def residuals(
    dynamics: Dynamics, motion: FilteredMotion, maps: Iterable[Map]
) -> Iterator[MapResidual]:
    """Least squares under maps whose loops mostly close."""
    every = tuple(maps)
    closing = compress(every, closed_shares(dynamics, motion, every) >= MOSTLY_CLOSED)
    yield from filter(None, (residual(dynamics, motion, map) for map in closing))


def tried(
    dynamics: Dynamics, motion: FilteredMotion, maps: Iterable[Map], *, as_is: bool = False
) -> Iterator[WiringHypothesis]:
    """The likeliest orders, signs and gains of the torque columns under maps whose loops close;
    with `as_is` torque columns keep their order."""
    for solved in residuals(dynamics, motion, maps):
        dof = len(solved.still)
        (orders, signs), values = patterns(dof), solved.evidences.copy()
        moved = orders != np.arange(dof)
        # At rest friction balances any torque, so sign and order are undetermined.
        values[np.any((moved | (signs < 0))[:, solved.still], axis=1)] = -np.inf
        if as_is:
            values[np.any(moved, axis=1)] = -np.inf
        ranked = np.argsort(-values, kind="stable")[: 1 if as_is else JUDGED]
        for k in ranked[np.isfinite(values[ranked])]:
            yield WiringHypothesis(solved, tuple(orders[k].tolist()), signs[k], float(values[k]))
        if not as_is and (far := _far_gains(solved)) is not None:
            yield far


def _far_gains(residual: MapResidual) -> WiringHypothesis | None:
    """Torque columns in their order, some of them in another unit than the others."""
    dof, gains = len(residual.still), np.ones(len(residual.still))
    as_is = WiringHypothesis(residual, tuple(range(dof)), gains.copy())
    tied = np.flatnonzero(~as_is.loose & ~residual.still)
    if len(tied) < 2:
        return None
    squares = np.sum(as_is.columns[:, tied] ** 2, axis=0)
    values, vectors = eigh(as_is.residual_products[np.ix_(tied, tied)], np.diag(squares))
    if values[1] < UNIT**2 * max(values[0], 0.0):
        return None
    u = vectors[:, 0] * np.sign(np.sum(vectors[:, 0] * as_is.correlations[tied]))
    u = u / np.median(np.abs(u))
    far = (np.abs(u) > UNIT) | (np.abs(u) < 1 / UNIT)
    gains[tied] = np.where(far, u, np.sign(u))
    # Rows are divided by gains; otherwise a large gain would only weight a drive less.
    by = np.repeat(np.abs(gains), residual.rows.samples)
    better = _share(residual.span, as_is.columns @ np.sign(gains))
    better /= _share(Span.of_columns(residual.Y / by[:, None]), as_is.columns @ gains / by)
    if better < UNIT or not np.any(far):
        return None
    evidence = float(residual.evidences.max()) + len(residual.Y) * float(np.log(better))
    return WiringHypothesis(residual, as_is.order, gains, evidence)


def _share(span: Span, tau: Float[np.ndarray, " rows"]) -> float:
    return float(np.linalg.norm(span.without(tau)) / np.linalg.norm(tau))
