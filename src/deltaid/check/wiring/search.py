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

# Least share of samples with closed loops for the mapping itself to be evaluated.
_EVALUATED = 0.3
# Hypotheses within this ratio of the best residual are as good.
_AS_GOOD = 1.2
# Those within this ratio are evaluated again on all samples, so many at most.
_NEAR, _DECIDED = 2.0, 6
# Correlation with the prior's torques that needs no search for gears of other drives.
_SURE = 0.9
# Range of factors of motor positions, points of the grid, and bisections.
_SMALLEST, _LARGEST, _GRID, _HALVINGS = 1 / 3000, 1 / 1.5, 16, 9
# The longest lead of a linear drive [m per rad]: half a metre per revolution.
_LONGEST = 0.5 / (2 * np.pi)
# How far units with a name are from the best factor, and the step that this is refined by.
_NAMED, _FINE = (0.7, 1.4), 1.04


def explained(dynamics: Dynamics, fine: Motion, coarse: Motion) -> tuple[Candidate, ...]:
    """The hypotheses that explain a recording as well as the best one, simplest first.

    The first is the mapping itself where none is clearly better; none if no loops close.

    Args:
        fine: to decide.
        coarse: a part of it, to search.
    """
    identity = Map.identity(dynamics.dof)
    as_mapped = next(tried(dynamics, fine, [identity], least=_EVALUATED), None)
    settled = as_mapped is not None and as_mapped.clear and as_mapped.changes == 0
    if as_mapped is not None and settled and not _other_order(dynamics, coarse):
        return (as_mapped,)
    maps = _orders(identity) if settled else _maps(dynamics)
    found = _ranked(tried(dynamics, coarse, (map for map in maps if _decidable(map, fine.moves))))
    if not settled and (not found or not found[0].clear or found[0].map.scaled):
        found = _ranked([*found, *_of_motors(dynamics, coarse)])
        if found and found[0].map.scaled:
            found = _ranked([*found, *_refined(dynamics, coarse, found[0])])
    close = [trial for trial in found if trial.left < _NEAR * found[0].left]
    close.sort(key=lambda trial: (trial.left > _AS_GOOD * found[0].left, trial.changes))
    maps = [*dict.fromkeys(trial.map for trial in close)][:_DECIDED]
    examined = [trial for trial in tried(dynamics, fine, maps) if trial.sensible]
    if as_mapped is not None:
        examined = [*(trial for trial in examined if trial.map != identity), as_mapped]
    if not examined:
        return ()
    examined = _ranked(examined)
    good = [trial for trial in examined if trial.left < _AS_GOOD * examined[0].left]
    if as_mapped is not None and as_mapped.residual.poses.share >= MOSTLY_CLOSED:
        good = [trial for trial in good if trial.beats(as_mapped)] or [as_mapped]
    if good[0].map.scaled:
        good = [trial for trial in good if trial.as_likely_as(good[0])]
    good.sort(key=lambda trial: (trial.changes, trial.unnamed, trial.map != identity))
    return tuple(good)


def _decidable(map: Map, moves: Bool[np.ndarray, " drives"]) -> bool:
    """Whether it changes columns that move: at rest sign, unit and drive are undetermined."""
    moved = [a != i or f != 1 for i, (a, f) in enumerate(zip(map.order, map.scale, strict=True))]
    changed = np.flatnonzero(moved)
    alone = changed[~moves[changed]]
    return not alone.size or (len(changed) == len(moves) and len(set(map.scale)) == 1)


def _ranked(candidates: Iterable[Candidate]) -> list[Candidate]:
    return sorted(candidates, key=lambda candidate: candidate.left)


def _orders(as_mapped: Map) -> Iterator[Map]:
    return (replace(as_mapped, order=order) for order in permutations(as_mapped.order))


def _other_order(dynamics: Dynamics, motion: Motion) -> bool:
    """Whether all columns together fit better in another order; the first is the mapping's."""
    identity = Map.identity(dynamics.dof)
    solved = residuals(dynamics, motion, _orders(identity))
    shares = [solution.share(solution.map.order, np.array(identity.scale)) for solution in solved]
    return len(shares) > 1 and shares[0] > 1.02 * min(shares)


def _maps(dynamics: Dynamics) -> Iterator[Map]:
    """As mapped, with other signs, in another order, in other units."""
    identity, every = Map.identity(dynamics.dof), range(dynamics.dof)
    yield identity
    for drives in ([i] for i in every):
        yield identity.times(-1.0, drives)
    if len(every) > 1:
        yield identity.times(-1.0, every)
    yield from (map for map in _orders(identity) if map != identity)
    for drives in _groups(dynamics):
        for factor in _units(dynamics, drives[0]):
            yield identity.times(factor, drives)


def _groups(dynamics: Dynamics) -> Iterator[list[int]]:
    """Drives that may share a fault: all of a kind, or each alone except a telescope's, whose loops
    determine no unit."""
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
    identity, linear = Map.identity(dynamics.dof), _units(dynamics, drives[0]) is SLIDING

    def closes(factor: float) -> bool:
        return closed_share(dynamics, motion, identity.times(factor, drives)) >= CLOSED

    low, high = _SMALLEST, _LONGEST if linear else _LARGEST
    if not closes(high):
        if not closes(low):
            return None
        for _ in range(_HALVINGS):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        low, high = max(_SMALLEST, low / 30), low
    grid = np.geomspace(low, high, _GRID)
    maps = (identity.times(float(factor), drives) for factor in grid)
    rough = next(iter(_ranked(tried(dynamics, motion, maps, as_is=True))), None)
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
    """The best factor of the scaled positions, from a rough one, by parabolas."""

    def times(by: float) -> Candidate | None:
        map = best.map.times(by, best.map.scaled)
        return next(tried(dynamics, motion, [map], as_is=True), None)

    best = rough
    for _ in range(3):
        trials = [times(by) for by in (1 / step, step)]
        lower, higher = (np.inf if trial is None else trial.left**2 for trial in trials)
        bend = lower + higher - 2 * best.left**2
        if np.isfinite(bend) and bend > 0:
            shift = float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))
            trials.append(times(step**shift))
        best = _ranked([best, *filter(None, trials)])[0]
        step = float(np.sqrt(step))
    return best
