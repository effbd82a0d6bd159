"""Hypotheses about columns of positions and torques, and which of them explains a recording."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import eigh

from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map, Residual, poses, residual
from deltaid.dynamics.dynamics import Dynamics

# A gain so far from the others' is no error of calibration.
GAIN = 2.5
# Share of the samples whose loops must close, and at which a hypothesis is looked at at all.
CLOSED, _CLOSED, _LOOKED_AT = 0.98, 0.9, 0.3
# Samples that closing is tried on first.
_FEW = 40
# Torques that go with the prior's like this, and gains that show like this, need no search.
_ALONG, _ALONG_LOOSE, _SURE, _SHOWN = 0.85, 0.6, 0.9, 4.0
# Gains far from the others' must show like this.
_SHOWN_FAR = 3.0
# Least correlation with the prior's torques, and most of the torques left, of a hypothesis that is
# believed, and of one with factors of positions.
_SENSIBLE, _SENSIBLE_SCALED = (0.5, 0.5), (0.75, 0.25)
# Hypotheses that leave so much more than the best one are as good as it.
_AS_GOOD = 1.2
# One that leaves more than this must leave half of what the mapping does.
_DOUBTED = 0.03
# Signs against the prior must leave so much less than those that go with it.
_CLEARLY = 0.7
# Those that are looked at again on all samples, and how many at most.
_NEAR, _DECIDED = 2.0, 6
# A hypothesis must leave so much less than the mapping does.
# One with factors of positions, which fit anything, so much less.
_BETTER, _SURELY, _FAR_BETTER = 1.06, 100.0, 3.0
# Twice the logarithm of a likelihood ratio beyond which a factor of positions is not as good as
# another: noise that is not white counts several times.
_CERTAIN = 25.0
# Correlation of residuals of drives that hang together.
_TIED = 0.25
# Factors that positions of a motor are looked for by, and how many.
_SMALLEST, _LARGEST, _GRID, _HALVINGS = 1 / 3000, 1 / 1.5, 16, 9
# The longest lead of a linear drive [m per rad]: half a metre per revolution.
_LONGEST = 0.5 / (2 * np.pi)

# Units that numbers may really be in, by the factor to the joint's own.
TURNING = {np.pi / 180: "degrees", 2 * np.pi: "revolutions", 180 / np.pi: "radians"}
SLIDING = {1e-3: "millimetres", 1e3: "metres"}


@dataclass(frozen=True, eq=False)
class Candidate:
    """One assignment of columns, and what it leaves of the torques.

    Attributes:
        residual: under its map of the positions.
        order: the torque column of each drive.
        gains: of these, with sign: drive torque = gain · number; ±1, or a gain far from 1.
        loose: drives whose gain does not show beside those of the others.
        left: share of the torques that is not explained, raised by samples that do not close.
        shown: how many times more the next worse gains leave.
    """

    residual: Residual
    order: tuple[int, ...]
    gains: Float[np.ndarray, " drives"]
    loose: np.ndarray
    left: float
    shown: float

    @property
    def map(self) -> Map:
        """Of the positions."""
        return self.residual.map

    @property
    def along(self) -> Float[np.ndarray, " drives"]:
        """Correlation of each drive's torque with that of the prior."""
        n = len(self.order)
        return np.sign(self.gains) * self.residual.along[np.arange(n), list(self.order)]

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
        along, left = _SENSIBLE_SCALED if self.scaled else _SENSIBLE
        return bool(np.all(self.along[~self.loose] > along)) and self.left < left

    @property
    def changes(self) -> int:
        """How many columns are not what the mapping says."""
        m, plain = self.map, range(len(self.order))
        moved = sum(a != b for a, b in zip(m.order, plain, strict=True))
        moved += sum(a != b for a, b in zip(self.order, plain, strict=True))
        return moved + _distinct(np.array(m.scale)) + _distinct(self.gains)

    @property
    def scaled(self) -> bool:
        """Whether some positions are in another unit or of another shaft."""
        return any(abs(factor) != 1 for factor in self.map.scale)

    @property
    def unnamed(self) -> bool:
        """Whether they are in no unit that has a name."""
        return any(abs(f) not in (1, *TURNING, *SLIDING) for f in self.map.scale)

    def beats(self, plain: "Candidate") -> bool:
        """Whether it leaves so much less than the positions as mapped that these are out."""
        if self is plain:
            return True
        if self.scaled:
            return plain.left > _FAR_BETTER * self.left
        if self.left > _DOUBTED and plain.left < 2 * self.left:
            return False
        if plain.changes:
            return True
        surely = self.residual.A.shape[1] * np.log(plain.left / self.left) > _SURELY
        return bool(surely and plain.left > _BETTER * self.left)

    def as_likely_as(self, best: "Candidate") -> bool:
        """Whether noise can have made the difference to what leaves least."""
        rows = self.residual.A.shape[1]
        return bool(rows * np.log(self.left**2 / best.left**2) < _CERTAIN)


def _distinct(factors: Float[np.ndarray, " drives"]) -> int:
    """Drives with a factor, or 1 where all have the same."""
    odd = int(np.sum(factors != 1))
    return 1 if odd == len(factors) and np.ptp(factors) == 0 else odd


def explained(dynamics: Dynamics, fine: Motion, coarse: Motion) -> tuple[Candidate, ...]:
    """The hypotheses that explain a recording as well as the best one, simplest first.

    The first is the mapping itself where none is clearly better; none if no loops close.

    Args:
        fine: what is decided on.
        coarse: a part of it, to look for hypotheses.
    """
    identity = Map.identity(dynamics.dof)
    plain = next(tried(dynamics, fine, [identity], least=_LOOKED_AT), None)
    settled = plain is not None and plain.clear and plain.changes == 0
    if plain is not None and settled and not _other_order(dynamics, coarse):
        return (plain,)
    maps = _orders(dynamics) if settled else _maps(dynamics)
    maps = (one for one in maps if _told(one, fine.moves))
    found = _ranked(tried(dynamics, coarse, maps))
    if not settled and (not found or not found[0].clear or found[0].scaled):
        found = _ranked([*found, *_of_motors(dynamics, coarse)])
        if found and found[0].scaled:
            found = _ranked([*found, *_refined(dynamics, coarse, found[0])])
    near: list[Candidate] = [one for one in found if one.left < _NEAR * found[0].left]
    near.sort(key=lambda one: (one.left > _AS_GOOD * found[0].left, one.changes))
    maps = [*dict.fromkeys(one.map for one in near)][:_DECIDED]
    decided = [one for one in tried(dynamics, fine, maps) if one.sensible]
    if plain is not None:
        decided = [*(one for one in decided if one.map != identity), plain]
    if not decided:
        return ()
    decided = _ranked(decided)
    good = [one for one in decided if one.left < _AS_GOOD * decided[0].left]
    if plain is not None and plain.residual.poses.share >= _CLOSED:
        good = [one for one in good if one.beats(plain)] or [plain]
    if good[0].scaled:
        good = [one for one in good if one.as_likely_as(good[0])]
    good.sort(key=lambda one: (one.changes, one.unnamed, one.map != identity))
    return tuple(good)


def _told(map: Map, moves: Bool[np.ndarray, " drives"]) -> bool:
    """Whether it changes columns that move: at rest none tells its sign, unit or drive."""
    moved = [a != i or f != 1 for i, (a, f) in enumerate(zip(map.order, map.scale, strict=True))]
    changed = np.flatnonzero(moved)
    alone = changed[~moves[changed]]
    return not alone.size or (len(changed) == len(moves) and len(set(map.scale)) == 1)


def _ranked(found: Iterable[Candidate]) -> list[Candidate]:
    return sorted(found, key=lambda one: one.left)


def tried(
    dynamics: Dynamics,
    motion: Motion,
    maps: Iterable[Map],
    least: float = _CLOSED,
    *,
    as_is: bool = False,
) -> Iterator[Candidate]:
    """Candidates of those maps whose loops close.

    Args:
        least: the share of the samples at which they must.
        as_is: whether torque columns stay in their order.
    """
    few = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)
    for one in maps:
        if poses(dynamics, one.values(motion.q[few])).share < least:
            continue
        found = residual(dynamics, motion, one)
        if found is not None:
            plain = tuple(range(dynamics.dof))
            yield assigned(found, plain) if as_is else best_of(found)


def _orders(dynamics: Dynamics) -> Iterator[Map]:
    plain = Map.identity(dynamics.dof)
    return (replace(plain, order=order) for order in permutations(plain.order))


def _other_order(dynamics: Dynamics, motion: Motion) -> bool:
    """Whether all columns together fit better in another order; the first is the mapping's."""
    left = []
    few = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)
    for map in _orders(dynamics):
        if poses(dynamics, map.values(motion.q[few])).share >= _CLOSED:
            found = residual(dynamics, motion, map)
            if found is not None:
                left.append(found.share(map.order, np.ones(len(map.order))))
    return len(left) > 1 and left[0] > 1.02 * min(left)


def _maps(dynamics: Dynamics) -> Iterator[Map]:
    dof = dynamics.dof
    plain = Map.identity(dof)
    yield plain
    for i in range(dof):
        yield replace(plain, scale=_only(dof, [i], -1.0))
    if dof > 1:
        yield replace(plain, scale=(-1.0,) * dof)
    for order in permutations(range(dof)):
        if order != plain.order:
            yield replace(plain, order=order)
    for drives in groups(dynamics):
        linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
        for factor in SLIDING if linear else TURNING:
            yield replace(plain, scale=_only(dof, drives, factor))


def groups(dynamics: Dynamics) -> Iterator[list[int]]:
    """Drives that may have a fault in common: all of a kind, or each alone.

    A drive that turns a telescope shows no unit by its loops, so it is not tried alone.
    """
    robot = dynamics.robot
    linear = [robot.is_linear(drive) for drive in robot.drives]
    for kind in sorted(set(linear)):
        same = [i for i, slides in enumerate(linear) if slides == kind]
        if len(same) > 1:
            yield same
    limbs = dynamics.dof if robot.telescope is None else 3
    yield from ([i] for i in range(limbs))


def _only(dof: int, drives: list[int], factor: float) -> tuple[float, ...]:
    return tuple(factor if i in drives else 1.0 for i in range(dof))


def _of_motors(dynamics: Dynamics, motion: Motion) -> Iterator[Candidate]:
    """Positions of motors, by the factor that explains the torques best."""
    for drives in groups(dynamics):
        best = _best_factor(dynamics, motion, drives)
        if best is not None:
            yield best
        if best is not None and best.clear and best.along.min() > _SURE:
            return


def _best_factor(dynamics: Dynamics, motion: Motion, drives: list[int]) -> Candidate | None:
    dof, plain = dynamics.dof, Map.identity(dynamics.dof)
    few = np.linspace(0, len(motion.q) - 1, _FEW).astype(int)

    def at(factor: float) -> Map:
        return replace(plain, scale=_only(dof, drives, factor))

    def closes(factor: float) -> bool:
        return poses(dynamics, at(factor).values(motion.q[few])).share >= CLOSED

    linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
    low, high = _SMALLEST, _LONGEST if linear else _LARGEST
    if not closes(high):
        if not closes(low):
            return None
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        high = low
        low = max(_SMALLEST, high / 30)
    grid = np.geomspace(low, high, _GRID)
    found = [next(tried(dynamics, motion, [at(float(f))], as_is=True), None) for f in grid]
    left = np.array([np.inf if one is None else one.left for one in found])
    k = int(np.argmin(left))
    if not np.isfinite(left[k]):
        return None
    one = found[k]
    if one is None:
        return None
    best = _narrowed(dynamics, motion, one, float(grid[1] / grid[0]))
    lead = abs(best.map.scale[drives[0]])
    return None if linear and lead > _LONGEST else best


def _refined(dynamics: Dynamics, motion: Motion, rough: Candidate) -> Iterator[Candidate]:
    """The same drives in a unit that has a name, and by the best factor near the rough one."""
    scale = rough.map.scale
    drives = [i for i, factor in enumerate(scale) if abs(factor) != 1]
    linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
    best = _narrowed(dynamics, motion, rough, 1.04)
    yield best
    factor = abs(best.map.scale[drives[0]])
    near = [unit for unit in (SLIDING if linear else TURNING) if 0.7 < unit / factor < 1.4]
    signs = np.sign(scale)
    for unit in near:
        named = tuple(float(s) * (unit if i in drives else 1.0) for i, s in enumerate(signs))
        yield from tried(dynamics, motion, [replace(rough.map, scale=named)])


def _narrowed(dynamics: Dynamics, motion: Motion, rough: Candidate, step: float) -> Candidate:
    """The factor of the scaled positions that leaves least, from a rough one, by parabolas."""
    best = rough
    for _ in range(3):
        beside = [_times(dynamics, motion, best, by) for by in (1 / step, step)]
        lower, higher = ((np.inf if one is None else one.left**2) for one in beside)
        if np.isfinite(lower + higher) and lower + higher > 2 * best.left**2:
            bend = lower + higher - 2 * best.left**2
            shift = float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))
            beside.append(_times(dynamics, motion, best, step**shift))
        best = min((best, *(one for one in beside if one is not None)), key=lambda one: one.left)
        step = float(np.sqrt(step))
    return best


def _times(dynamics: Dynamics, motion: Motion, one: Candidate, by: float) -> Candidate | None:
    """The same with the scaled positions times a factor more."""
    scale = tuple(f if abs(f) == 1 else float(f * by) for f in one.map.scale)
    return next(tried(dynamics, motion, [replace(one.map, scale=scale)], as_is=True), None)


def best_of(found: Residual) -> Candidate:
    """The best order, signs and gains of torque columns."""
    plain = assigned(found, tuple(range(len(found.weights))))
    others = [assigned(found, order) for order in permutations(range(len(found.weights)))]
    best = min(others, key=lambda one: one.left)
    return best if best.left < 0.7 * plain.left else plain


def assigned(found: Residual, order: tuple[int, ...]) -> Candidate:
    """The best signs and gains of one order of the torque columns."""
    S, D = found.of(order)
    n = len(order)
    loose = _loose(S)
    values, vectors = eigh(S, np.diag(D))
    u = vectors[:, 0]
    tied = np.flatnonzero(~loose)
    shown = np.inf
    if len(tied) > 1:
        values, vectors = eigh(S[np.ix_(tied, tied)], np.diag(D[tied]))
        u[tied] = vectors[:, 0]
        shown = float(np.sqrt(max(values[1], 0.0) / max(values[0], 1e-30)))
    sign, gains = _settled(found.along[np.arange(n), list(order)], u, loose)
    sign[found.still] = gains[found.still] = 1.0
    raised, left = 1 + 3 * (1 - found.poses.share), found.share(order, sign)
    against = (found.along[np.arange(n), list(order)] < 0) & ~found.still
    expected = np.where(against, -1.0, 1.0)
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
    """Drives whose gain does not show: their residual goes with no other's.

    Of limbs that share a platform it does by 0.5 at least, of a telescope's drive by 0.1 at most.
    """
    size = np.sqrt(np.maximum(np.diag(S), np.finfo(float).tiny))
    return (np.abs(S / np.outer(size, size)) - np.eye(len(S))).max(axis=0) < _TIED


def _settled(
    along: Float[np.ndarray, " drives"], u: Float[np.ndarray, " drives"], loose: np.ndarray
) -> tuple[Float[np.ndarray, " drives"], Float[np.ndarray, " drives"]]:
    """Signs, and with them gains: 1 but where one is far from those of the others.

    Signs of drives that hang together are one another's; which of both ways, and the sign of a
    loose drive, the prior says.
    """
    sign, tied = np.where(u < 0, -1.0, 1.0), ~loose
    if np.sum(sign[tied] * along[tied]) < 0:
        sign[tied] *= -1
    sign[loose] = np.where(along[loose] < 0, -1.0, 1.0)
    size = np.abs(u) / np.median(np.abs(u[tied])) if tied.sum() > 1 else np.ones(len(u))
    far = tied & ((size > GAIN) | (size < 1 / GAIN))
    return sign, np.where(far, sign * size, sign)
