"""One assignment of columns to drives, and how well it explains a recording."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import eigh

from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map, Residual, poses, residual
from deltaid.dynamics.dynamics import Dynamics

# A gain so far from the others' is no calibration error; least margin that it needs.
_GAIN, _SHOWN_FAR = 2.5, 3.0
# Share of the samples whose loops must close, and of the few tried first.
CLOSED, MOSTLY_CLOSED = 0.98, 0.9
_FEW = 40
# Correlation with the prior's torques, and margin of gains, that need no search.
_ALONG, _ALONG_LOOSE, _SHOWN = 0.85, 0.6, 4.0
# Least correlation with the prior's torques and largest residual of a hypothesis to consider, and
# of one with factors of positions.
_SENSIBLE, _SENSIBLE_SCALED = (0.5, 0.5), (0.75, 0.25)
# Residual that another order may leave at most, and signs against the prior, as a share.
_OTHER_ORDER, _CLEARLY = 0.7, 0.7
# With a larger residual than this a hypothesis must halve that of the mapping.
_DOUBTED = 0.03
# Ratio of the mapping's residual to that of a hypothesis, log likelihood ratio, and ratio for
# factors of positions, which fit anything.
_BETTER, _SURELY, _FAR_BETTER = 1.06, 100.0, 3.0
# Twice the logarithm of a likelihood ratio beyond which a factor of positions is not as good as
# another: noise that is not white counts several times.
_CERTAIN = 25.0
# Correlation of residuals of drives that hang together.
_TIED = 0.25

# Units that numbers may really be in, by the factor to the joint's own.
TURNING = {np.pi / 180: "degrees", 2 * np.pi: "revolutions", 180 / np.pi: "radians"}
SLIDING = {1e-3: "millimetres", 1e3: "metres"}


@dataclass(frozen=True, eq=False)
class Candidate:
    """One assignment of columns, and its residual torques.

    Attributes:
        order: the torque column of each drive.
        gains: of these, with sign: drive torque = gain · number; ±1, or a gain far from 1.
        loose: drives whose gain is not determined by those of the others.
        left: unexplained share of the torques, raised by samples that do not close.
        shown: residual of the next worse gains over that of these.
    """

    residual: Residual
    order: tuple[int, ...]
    gains: Float[np.ndarray, " drives"]
    loose: Bool[np.ndarray, " drives"]
    left: float
    shown: float

    @property
    def map(self) -> Map:
        return self.residual.map

    @property
    def along(self) -> Float[np.ndarray, " drives"]:
        """Correlation of each drive's torque with that of the prior."""
        return np.sign(self.gains) * _along(self.residual, self.order)

    @property
    def closes(self) -> bool:
        """Whether the loops close along the recording."""
        return self.residual.poses.share >= CLOSED

    @property
    def clear(self) -> bool:
        """Whether no search is needed."""
        least = np.where(self.loose, _ALONG_LOOSE, _ALONG)
        return self.closes and bool(np.all(self.along > least)) and self.shown > _SHOWN

    @property
    def sensible(self) -> bool:
        """Whether torques correlate with the motion at all."""
        along, left = _SENSIBLE_SCALED if self.map.scaled else _SENSIBLE
        return bool(np.all(self.along[~self.loose] > along)) and self.left < left

    @property
    def changes(self) -> int:
        """Number of columns that differ from the mapping."""
        orders = (*enumerate(self.map.order), *enumerate(self.order))
        moved = sum(drive != column for drive, column in orders)
        return moved + _distinct(np.array(self.map.scale)) + _distinct(self.gains)

    @property
    def unnamed(self) -> bool:
        """Whether positions are in no unit that has a name."""
        return any(abs(f) not in (1, *TURNING, *SLIDING) for f in self.map.scale)

    def beats(self, as_mapped: "Candidate") -> bool:
        """Whether its residual rules out the positions as mapped."""
        if self is as_mapped:
            return True
        if self.map.scaled:
            return as_mapped.left > _FAR_BETTER * self.left
        if self.left > _DOUBTED and as_mapped.left < 2 * self.left:
            return False
        if as_mapped.changes:
            return True
        surely = len(self.residual.Y) * np.log(as_mapped.left / self.left) > _SURELY
        return bool(surely and as_mapped.left > _BETTER * self.left)

    def as_likely_as(self, best: "Candidate") -> bool:
        """Whether noise explains the difference to the best."""
        rows = len(self.residual.Y)
        return bool(rows * np.log(self.left**2 / best.left**2) < _CERTAIN)


def _along(residual: Residual, order: tuple[int, ...]) -> Float[np.ndarray, " drives"]:
    return residual.along[np.arange(len(order)), list(order)]


def _distinct(factors: Float[np.ndarray, " drives"]) -> int:
    """Drives with a factor, or 1 where all have the same."""
    odd = int(np.sum(factors != 1))
    return 1 if odd == len(factors) and np.ptp(factors) == 0 else odd


def residuals(
    dynamics: Dynamics, motion: Motion, maps: Iterable[Map], least: float = MOSTLY_CLOSED
) -> Iterator[Residual]:
    """Least squares under maps whose loops close at a share of the samples."""
    for map in maps:
        if closed_share(dynamics, motion, map) >= least:
            solved = residual(dynamics, motion, map)
            if solved is not None:
                yield solved


def closed_share(dynamics: Dynamics, motion: Motion, map: Map) -> float:
    """Share of samples whose loops close, estimated from a few."""
    chosen = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)
    return poses(dynamics, map.values(motion.q[chosen])).share


def tried(
    dynamics: Dynamics,
    motion: Motion,
    maps: Iterable[Map],
    least: float = MOSTLY_CLOSED,
    *,
    as_is: bool = False,
) -> Iterator[Candidate]:
    """Candidates of maps whose loops close.

    Args:
        least: share of the samples that must close.
        as_is: whether torque columns keep their order.
    """
    as_listed = tuple(range(dynamics.dof))
    for solved in residuals(dynamics, motion, maps, least):
        best = as_mapped = assigned(solved, as_listed)
        if not as_is:
            orders = (assigned(solved, order) for order in permutations(as_listed))
            best = min(orders, key=lambda candidate: candidate.left)
        yield best if best.left < _OTHER_ORDER * as_mapped.left else as_mapped


def assigned(residual: Residual, order: tuple[int, ...]) -> Candidate:
    """The best signs and gains of one order of the torque columns."""
    (S, D), along = residual.of(order), _along(residual, order)
    loose = _loose(S)
    u, tied, margin = eigh(S, np.diag(D))[1][:, 0], np.flatnonzero(~loose), np.inf
    if len(tied) > 1:
        values, vectors = eigh(S[np.ix_(tied, tied)], np.diag(D[tied]))
        u[tied] = vectors[:, 0]
        margin = float(np.sqrt(max(values[1], 0.0) / max(values[0], 1e-30)))
    sign, gains = _settled(along, u, loose)
    sign[residual.still] = gains[residual.still] = 1.0
    raised, share = 1 + 3 * (1 - residual.poses.share), residual.share(order, sign)
    expected = np.where((along < 0) & ~residual.still, -1.0, 1.0)
    if np.any(expected != sign) and share > _CLEARLY * residual.share(order, expected):
        # Signs are not determined, as without noise or with one drive.
        sign = gains = expected
        share = residual.share(order, sign)
    if margin > _SHOWN_FAR and np.any(gains != sign):
        far = residual.own_share(order, gains)
        if share > _FAR_BETTER * far:  # else an unexplained drive is only weighted less
            return Candidate(residual, order, gains, loose, raised * far, margin)
    return Candidate(residual, order, sign, loose, raised * share, margin)


def _loose(S: Float[np.ndarray, "drives drives"]) -> Bool[np.ndarray, " drives"]:
    """Drives with undetermined gain: their residual correlates with no other's. Limbs that share a
    platform correlate by 0.5 at least, a telescope's drive by 0.1 at most."""
    size = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
    return (np.abs(S / np.outer(size, size)) - np.eye(len(S))).max(axis=0) < _TIED


def _settled(
    along: Float[np.ndarray, " drives"], u: Float[np.ndarray, " drives"], loose: np.ndarray
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """Signs and gains, ±1 unless one is far from the others. The prior decides the common sign of
    coupled drives, and the sign of a loose one."""
    sign, tied = np.where(u < 0, -1.0, 1.0), ~loose
    if np.sum(sign[tied] * along[tied]) < 0:
        sign[tied] *= -1
    sign[loose] = np.where(along[loose] < 0, -1.0, 1.0)
    size = np.abs(u) / np.median(np.abs(u[tied])) if tied.sum() > 1 else np.ones(len(u))
    far = tied & ((size > _GAIN) | (size < 1 / _GAIN))
    return sign, np.where(far, sign * size, sign)
