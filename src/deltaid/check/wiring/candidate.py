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

# A gain so far from the others' is no error of calibration; it must show like this.
_GAIN, _SHOWN_FAR = 2.5, 3.0
# Share of the samples whose loops must close; by the few that closing is tried on first.
CLOSED, MOSTLY_CLOSED = 0.98, 0.9
_FEW = 40
# Torques that go with the prior's like this, and gains that show like this, need no search.
_ALONG, _ALONG_LOOSE, _SHOWN = 0.85, 0.6, 4.0
# Least correlation with the prior's torques, and most of the torques left, of a hypothesis that is
# believed, and of one with factors of positions.
_SENSIBLE, _SENSIBLE_SCALED = (0.5, 0.5), (0.75, 0.25)
# Another order must leave so much less, signs against the prior so much less than those with it.
_OTHER_ORDER, _CLEARLY = 0.7, 0.7
# One that leaves more than this must leave half of what the mapping does.
_DOUBTED = 0.03
# A hypothesis must leave so much less than the mapping does; one with factors of positions, which
# fit anything, so much less.
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
    """One assignment of columns, and what it leaves of the torques.

    Attributes:
        order: the torque column of each drive.
        gains: of these, with sign: drive torque = gain · number; ±1, or a gain far from 1.
        loose: drives whose gain does not show beside those of the others.
        left: share of the torques that is not explained, raised by samples that do not close.
        shown: how many times more the next worse gains leave.
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
        """Whether nothing better can be hoped for."""
        least = np.where(self.loose, _ALONG_LOOSE, _ALONG)
        return self.closes and bool(np.all(self.along > least)) and self.shown > _SHOWN

    @property
    def sensible(self) -> bool:
        """Whether it makes torques go with the motion at all."""
        along, left = _SENSIBLE_SCALED if self.map.scaled else _SENSIBLE
        return bool(np.all(self.along[~self.loose] > along)) and self.left < left

    @property
    def changes(self) -> int:
        """How many columns are not what the mapping says."""
        orders = (*enumerate(self.map.order), *enumerate(self.order))
        moved = sum(drive != column for drive, column in orders)
        return moved + _distinct(np.array(self.map.scale)) + _distinct(self.gains)

    @property
    def unnamed(self) -> bool:
        """Whether positions are in no unit that has a name."""
        return any(abs(f) not in (1, *TURNING, *SLIDING) for f in self.map.scale)

    def beats(self, plain: "Candidate") -> bool:
        """Whether it leaves so much less than the positions as mapped that these are out."""
        if self is plain:
            return True
        if self.map.scaled:
            return plain.left > _FAR_BETTER * self.left
        if self.left > _DOUBTED and plain.left < 2 * self.left:
            return False
        if plain.changes:
            return True
        surely = len(self.residual.Y) * np.log(plain.left / self.left) > _SURELY
        return bool(surely and plain.left > _BETTER * self.left)

    def as_likely_as(self, best: "Candidate") -> bool:
        """Whether noise can have made the difference to what leaves least."""
        rows = len(self.residual.Y)
        return bool(rows * np.log(self.left**2 / best.left**2) < _CERTAIN)


def _along(found: Residual, order: tuple[int, ...]) -> Float[np.ndarray, " drives"]:
    return found.along[np.arange(len(order)), list(order)]


def _distinct(factors: Float[np.ndarray, " drives"]) -> int:
    """Drives with a factor, or 1 where all have the same."""
    odd = int(np.sum(factors != 1))
    return 1 if odd == len(factors) and np.ptp(factors) == 0 else odd


def residuals(
    dynamics: Dynamics, motion: Motion, maps: Iterable[Map], least: float = MOSTLY_CLOSED
) -> Iterator[Residual]:
    """Least squares under those maps whose loops close at so many of the samples."""
    for map in maps:
        if closed_share(dynamics, motion, map) >= least:
            found = residual(dynamics, motion, map)
            if found is not None:
                yield found


def closed_share(dynamics: Dynamics, motion: Motion, map: Map) -> float:
    """Share of the samples whose loops close, by a few of them."""
    few = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)
    return poses(dynamics, map.values(motion.q[few])).share


def tried(
    dynamics: Dynamics,
    motion: Motion,
    maps: Iterable[Map],
    least: float = MOSTLY_CLOSED,
    *,
    as_is: bool = False,
) -> Iterator[Candidate]:
    """Candidates of those maps whose loops close.

    Args:
        least: the share of the samples at which they must.
        as_is: whether torque columns stay in their order.
    """
    plain = tuple(range(dynamics.dof))
    for found in residuals(dynamics, motion, maps, least):
        best = as_mapped = assigned(found, plain)
        if not as_is:
            orders = (assigned(found, order) for order in permutations(plain))
            best = min(orders, key=lambda candidate: candidate.left)
        yield best if best.left < _OTHER_ORDER * as_mapped.left else as_mapped


def assigned(found: Residual, order: tuple[int, ...]) -> Candidate:
    """The best signs and gains of one order of the torque columns."""
    (S, D), along = found.of(order), _along(found, order)
    loose = _loose(S)
    u, tied, shown = eigh(S, np.diag(D))[1][:, 0], np.flatnonzero(~loose), np.inf
    if len(tied) > 1:
        values, vectors = eigh(S[np.ix_(tied, tied)], np.diag(D[tied]))
        u[tied] = vectors[:, 0]
        shown = float(np.sqrt(max(values[1], 0.0) / max(values[0], 1e-30)))
    sign, gains = _settled(along, u, loose)
    sign[found.still] = gains[found.still] = 1.0
    raised, left = 1 + 3 * (1 - found.poses.share), found.share(order, sign)
    expected = np.where((along < 0) & ~found.still, -1.0, 1.0)
    if np.any(expected != sign) and left > _CLEARLY * found.share(order, expected):
        # The recording does not tell signs, such as one without noise or of one drive.
        sign = gains = expected
        left = found.share(order, sign)
    if shown > _SHOWN_FAR and np.any(gains != sign):
        far = found.own_share(order, gains)
        if left > _FAR_BETTER * far:  # else a drive that nothing explains is only weighed less
            return Candidate(found, order, gains, loose, raised * far, shown)
    return Candidate(found, order, sign, loose, raised * left, shown)


def _loose(S: Float[np.ndarray, "drives drives"]) -> Bool[np.ndarray, " drives"]:
    """Drives whose gain does not show: their residual goes with no other's. Of limbs that share a
    platform it does by 0.5 at least, of a telescope's drive by 0.1 at most."""
    size = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
    return (np.abs(S / np.outer(size, size)) - np.eye(len(S))).max(axis=0) < _TIED


def _settled(
    along: Float[np.ndarray, " drives"], u: Float[np.ndarray, " drives"], loose: np.ndarray
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """Signs, and with them gains: 1 but where one is far from the others. Which of both ways drives
    that hang together have them, and the sign of a loose one, the prior says."""
    sign, tied = np.where(u < 0, -1.0, 1.0), ~loose
    if np.sum(sign[tied] * along[tied]) < 0:
        sign[tied] *= -1
    sign[loose] = np.where(along[loose] < 0, -1.0, 1.0)
    size = np.abs(u) / np.median(np.abs(u[tied])) if tied.sum() > 1 else np.ones(len(u))
    far = tied & ((size > _GAIN) | (size < 1 / _GAIN))
    return sign, np.where(far, sign * size, sign)
