"""Hypotheses about columns of positions and torques, and which of them explain a recording.

A hypothesis is a map of the position columns: another sign, order or unit, or positions of motors
behind gears that are not declared, by the factor that explains the torques best.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool

from deltaid.check.wiring.candidate import (
    CLOSED,
    MOSTLY_CLOSED,
    SLIDING,
    TURNING,
    Candidate,
    closed_share,
    residuals,
    tried,
)
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map
from deltaid.dynamics.dynamics import Dynamics

# Share of the samples whose loops close at which the mapping itself is looked at at all.
_LOOKED_AT = 0.3
# Hypotheses that leave so much more than the best one are as good as it.
_AS_GOOD = 1.2
# Those that are looked at again on all samples, and how many at most.
_NEAR, _DECIDED = 2.0, 6
# Torques that go with the prior's like this need no search for the gears of other drives.
_SURE = 0.9
# Factors that positions of a motor are looked for by, and how many.
_SMALLEST, _LARGEST, _GRID, _HALVINGS = 1 / 3000, 1 / 1.5, 16, 9
# The longest lead of a linear drive [m per rad]: half a metre per revolution.
_LONGEST = 0.5 / (2 * np.pi)
# How far units with a name are from the best factor, and the step that this is refined by.
_NAMED, _FINE = (0.7, 1.4), 1.04


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
    maps = _orders(identity) if settled else _maps(dynamics)
    found = _ranked(tried(dynamics, coarse, (map for map in maps if _told(map, fine.moves))))
    if not settled and (not found or not found[0].clear or found[0].map.scaled):
        found = _ranked([*found, *_of_motors(dynamics, coarse)])
        if found and found[0].map.scaled:
            found = _ranked([*found, *_refined(dynamics, coarse, found[0])])
    near = [candidate for candidate in found if candidate.left < _NEAR * found[0].left]
    near.sort(key=lambda one: (one.left > _AS_GOOD * found[0].left, one.changes))
    maps = [*dict.fromkeys(candidate.map for candidate in near)][:_DECIDED]
    decided = [candidate for candidate in tried(dynamics, fine, maps) if candidate.sensible]
    if plain is not None:
        decided = [*(one for one in decided if one.map != identity), plain]
    if not decided:
        return ()
    decided = _ranked(decided)
    good = [one for one in decided if one.left < _AS_GOOD * decided[0].left]
    if plain is not None and plain.residual.poses.share >= MOSTLY_CLOSED:
        good = [one for one in good if one.beats(plain)] or [plain]
    if good[0].map.scaled:
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
    return sorted(found, key=lambda candidate: candidate.left)


def _orders(plain: Map) -> Iterator[Map]:
    return (replace(plain, order=order) for order in permutations(plain.order))


def _other_order(dynamics: Dynamics, motion: Motion) -> bool:
    """Whether all columns together fit better in another order; the first is the mapping's."""
    plain = Map.identity(dynamics.dof)
    found = residuals(dynamics, motion, _orders(plain))
    left = [one.share(one.map.order, np.array(plain.scale)) for one in found]
    return len(left) > 1 and left[0] > 1.02 * min(left)


def _maps(dynamics: Dynamics) -> Iterator[Map]:
    """As mapped, with other signs, in another order, in other units."""
    plain, every = Map.identity(dynamics.dof), range(dynamics.dof)
    yield plain
    for drives in ([i] for i in every):
        yield plain.times(-1.0, drives)
    if len(every) > 1:
        yield plain.times(-1.0, every)
    yield from (map for map in _orders(plain) if map != plain)
    for drives in _groups(dynamics):
        for factor in _units(dynamics, drives[0]):
            yield plain.times(factor, drives)


def _groups(dynamics: Dynamics) -> Iterator[list[int]]:
    """Drives that may have a fault in common: all of a kind, or each alone but for one that turns a
    telescope, which shows no unit by its loops."""
    linear = [dynamics.robot.is_linear(drive) for drive in dynamics.robot.drives]
    for kind in sorted(set(linear)):
        same = [i for i, slides in enumerate(linear) if slides == kind]
        if len(same) > 1:
            yield same
    yield from ([i] for i in range(dynamics.dof if dynamics.robot.telescope is None else 3))


def _units(dynamics: Dynamics, drive: int) -> dict[float, str]:
    return SLIDING if dynamics.robot.is_linear(dynamics.robot.drives[drive]) else TURNING


def _of_motors(dynamics: Dynamics, motion: Motion) -> Iterator[Candidate]:
    """Positions of motors, by the factor that explains the torques best."""
    for drives in _groups(dynamics):
        best = _best_factor(dynamics, motion, drives)
        if best is not None:
            yield best
            if best.clear and best.along.min() > _SURE:
                return


def _best_factor(dynamics: Dynamics, motion: Motion, drives: list[int]) -> Candidate | None:
    plain, linear = Map.identity(dynamics.dof), _units(dynamics, drives[0]) is SLIDING

    def closes(factor: float) -> bool:
        return closed_share(dynamics, motion, plain.times(factor, drives)) >= CLOSED

    low, high = _SMALLEST, _LONGEST if linear else _LARGEST
    if not closes(high):
        if not closes(low):
            return None
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        low, high = max(_SMALLEST, low / 30), low
    grid = np.geomspace(low, high, _GRID)
    maps = (plain.times(float(factor), drives) for factor in grid)
    rough = min(tried(dynamics, motion, maps, as_is=True), key=lambda one: one.left, default=None)
    if rough is None:
        return None
    best = _narrowed(dynamics, motion, rough, float(grid[1] / grid[0]))
    return None if linear and abs(best.map.scale[drives[0]]) > _LONGEST else best


def _refined(dynamics: Dynamics, motion: Motion, rough: Candidate) -> Iterator[Candidate]:
    """The same drives in a unit that has a name, and by the best factor near the rough one."""
    drives = rough.map.scaled
    best = _narrowed(dynamics, motion, rough, _FINE)
    yield best
    factor = abs(best.map.scale[drives[0]])
    signs = replace(rough.map, scale=tuple(float(s) for s in np.sign(rough.map.scale)))
    low, high = _NAMED
    near = [unit for unit in _units(dynamics, drives[0]) if low < unit / factor < high]
    yield from tried(dynamics, motion, [signs.times(unit, drives) for unit in near])


def _narrowed(dynamics: Dynamics, motion: Motion, rough: Candidate, step: float) -> Candidate:
    """The factor of the scaled positions that leaves least, from a rough one, by parabolas."""

    def times(by: float) -> Candidate | None:
        map = best.map.times(by, best.map.scaled)
        return next(tried(dynamics, motion, [map], as_is=True), None)

    best = rough
    for _ in range(3):
        around = [times(by) for by in (1 / step, step)]
        lower, higher = (np.inf if one is None else one.left**2 for one in around)
        bend = lower + higher - 2 * best.left**2
        if np.isfinite(bend) and bend > 0:
            shift = float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))
            around.append(times(step**shift))
        best = min((best, *(one for one in around if one is not None)), key=lambda one: one.left)
        step = float(np.sqrt(step))
    return best
