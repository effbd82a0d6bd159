"""Hypotheses about columns of positions and torques, and which of them explain a recording."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np
from jaxtyping import Bool

from deltaid.check.wiring.candidate import (
    MOSTLY_CLOSED,
    SLIDING,
    TURNING,
    Candidate,
    closed_share,
    tried,
)
from deltaid.check.wiring.gears import groups, of_motors, only, refined
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map, residual
from deltaid.dynamics.dynamics import Dynamics

# Share of the samples whose loops close at which the mapping itself is looked at at all.
_LOOKED_AT = 0.3
# Hypotheses that leave so much more than the best one are as good as it.
_AS_GOOD = 1.2
# Those that are looked at again on all samples, and how many at most.
_NEAR, _DECIDED = 2.0, 6


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
        found = _ranked([*found, *of_motors(dynamics, coarse)])
        if found and found[0].scaled:
            found = _ranked([*found, *refined(dynamics, coarse, found[0])])
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
    if plain is not None and plain.residual.poses.share >= MOSTLY_CLOSED:
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


def _orders(dynamics: Dynamics) -> Iterator[Map]:
    plain = Map.identity(dynamics.dof)
    return (replace(plain, order=order) for order in permutations(plain.order))


def _other_order(dynamics: Dynamics, motion: Motion) -> bool:
    """Whether all columns together fit better in another order; the first is the mapping's."""
    left = []
    for map in _orders(dynamics):
        if closed_share(dynamics, motion, map) >= MOSTLY_CLOSED:
            found = residual(dynamics, motion, map)
            if found is not None:
                left.append(found.share(map.order, np.ones(len(map.order))))
    return len(left) > 1 and left[0] > 1.02 * min(left)


def _maps(dynamics: Dynamics) -> Iterator[Map]:
    dof = dynamics.dof
    plain = Map.identity(dof)
    yield plain
    for i in range(dof):
        yield replace(plain, scale=only(dof, [i], -1.0))
    if dof > 1:
        yield replace(plain, scale=(-1.0,) * dof)
    for order in permutations(range(dof)):
        if order != plain.order:
            yield replace(plain, order=order)
    for drives in groups(dynamics):
        linear = dynamics.robot.is_linear(f"drive{drives[0] + 1}")
        for factor in SLIDING if linear else TURNING:
            yield replace(plain, scale=only(dof, drives, factor))
