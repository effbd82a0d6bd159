"""Hypotheses about columns of positions and torques, and which of them explain a recording.

A hypothesis is a map of the position columns: another sign, order or unit, or positions of motors
behind gears that are not declared, by the factor that explains the torques best.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool

from deltaid.check.wiring.candidate import (
    CLOSED,
    LITTLE,
    MOSTLY_CLOSED,
    SLIDING,
    TURNING,
    Assignment,
    Candidate,
    as_good,
    closed_share,
    residuals,
    tried,
)
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map, Residual, residual
from deltaid.dynamics.dynamics import Dynamics

# Least share of samples with closed loops for the mapping itself to be evaluated.
_EVALUATED = 0.3
# Samples that hypotheses are tried on, those that are fitted, and those that are fitted again on
# all samples.
_SAMPLES, _FITTED, _DECIDED = 120, 16, 6
# Range of factors of motor positions, factors whose loops are tried, and points of the grid.
_SMALLEST, _LARGEST, _CLOSING, _GRID = 1 / 3000, 1 / 1.5, 48, 16
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
    identity, coarse = Map.identity(dynamics.dof), coarse.few(_SAMPLES)
    solved = next(residuals(dynamics, fine, [identity], least=_EVALUATED), None)
    as_mapped = solved and Candidate(solved, identity.order, np.ones(dynamics.dof))
    settled = as_mapped is not None and as_mapped.clear
    maps = _wirings(dynamics) if settled else _maps(dynamics)
    maps = (map for map in maps if _decidable(map, fine.moves))
    trials = _likely(tried(dynamics, coarse, maps))
    if as_mapped is not None and settled:
        own = next((trial.evidence for trial in trials if trial.changes == 0), -np.inf)
        if not trials or trials[0].evidence - own < as_good(len(trials[0].residual.Y)):
            return (as_mapped,)
    trials = _ranked(dynamics, trials)
    if not trials or trials[0].left > LITTLE or trials[0].map.scaled:
        trials = _ranked(dynamics, [*trials, *_of_motors(dynamics, coarse)])
        if trials and trials[0].map.scaled:
            trials = _ranked(dynamics, [*trials, *_refined(dynamics, coarse, trials[0])])
    examined = list[Candidate]()
    likely = sorted((t for t in trials if t.as_likely_as(trials[0])), key=_complexity)[:_DECIDED]
    for map in dict.fromkeys(trial.map for trial in likely):
        for solved in residuals(dynamics, fine, [map]):
            own = [trial for trial in likely if trial.map == map]
            examined += [Candidate(solved, trial.order, trial.gains) for trial in own]
    mapped = [] if as_mapped is None else [as_mapped]
    others = (trial for trial in examined if all(trial.key != own.key for own in mapped))
    examined = [*(trial for trial in others if trial.sensible), *mapped]
    if not examined:
        return ()
    best = max(examined, key=lambda trial: trial.score)
    good = [trial for trial in examined if trial.as_likely_as(best)]
    if as_mapped is not None and as_mapped.residual.poses.share >= MOSTLY_CLOSED:
        good = [trial for trial in good if trial.beats(as_mapped)] or [as_mapped]
    return tuple(sorted(good, key=_complexity))


def together(
    dynamics: Dynamics, motions: Sequence[Motion], each: Sequence[tuple[Candidate, ...]]
) -> tuple[tuple[Candidate, ...], ...]:
    """The hypotheses that explain several recordings of one wiring as well as the best one, for
    each recording: log likelihoods add.

    Args:
        each: the hypotheses that explain each recording by itself.
    """
    if all(good[0].changes == 0 for good in each):
        return tuple(each)
    keys = dict.fromkeys(candidate.key for good in each for candidate in good)
    keys[Map.identity(dynamics.dof), tuple(range(dynamics.dof)), (1.0,) * dynamics.dof] = None
    solved = [
        {map: residual(dynamics, motion, map) for map in dict.fromkeys(key[0] for key in keys)}
        for motion in motions
    ]
    trials = {key: [_on(of[key[0]], key) for of in solved] for key in keys}
    scores = {key: sum(c.score for c in own if c is not None) for key, own in trials.items()}
    best = max(scores, key=lambda key: scores[key])
    margin = as_good(sum(len(c.residual.Y) for c in trials[best] if c is not None))
    good = [key for key in keys if scores[best] - scores[key] < margin]
    simplest = sorted(
        (trials[key] for key in good), key=lambda own: min(map(_complexity, filter(None, own)))
    )
    return tuple(tuple(filter(None, own)) for own in zip(*simplest, strict=True))


def _on(residual: Residual | None, key: Assignment) -> Candidate | None:
    _, order, gains = key
    return None if residual is None else Candidate(residual, order, np.array(gains))


def _complexity(candidate: Candidate) -> tuple[int, bool, bool]:
    return candidate.changes, candidate.unnamed, candidate.map != Map.identity(len(candidate.order))


def _decidable(map: Map, moves: Bool[np.ndarray, " drives"]) -> bool:
    """Whether it changes columns that move: at rest sign, unit and drive are undetermined."""
    moved = [a != i or f != 1 for i, (a, f) in enumerate(zip(map.order, map.scale, strict=True))]
    changed = np.flatnonzero(moved)
    alone = changed[~moves[changed]]
    return not alone.size or (len(changed) == len(moves) and len(set(map.scale)) == 1)


def _likely(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Those that are worth a fit of a consistent robot, likeliest first.

    Limbs that are alike make several assignments equal: of those that are as good as the best, the
    simplest are fitted.
    """
    ranked = sorted(candidates, key=lambda candidate: -candidate.evidence)
    if not ranked:
        return []
    least = ranked[0].evidence - as_good(len(ranked[0].residual.Y))
    first = [trial for trial in ranked if trial.evidence > least]
    fitted = [*sorted(first, key=_complexity), *ranked[len(first) :]][:_FITTED]
    return sorted(fitted, key=lambda candidate: -candidate.evidence)


def _ranked(dynamics: Dynamics, candidates: Collection[Candidate]) -> list[Candidate]:
    """By likelihood, without those that cannot be as likely as the best whatever masses are: these
    need no fit of a consistent robot."""
    margin, best = as_good(dynamics.dof * _SAMPLES), -np.inf
    for trial in sorted(candidates, key=lambda candidate: -candidate.posed.highest):
        if trial.posed.highest < best - margin:
            break
        best = max(best, trial.score)
    fitted = (trial for trial in candidates if trial.posed.highest >= best - margin)
    return sorted(fitted, key=lambda candidate: -candidate.score)


def _wirings(dynamics: Dynamics) -> Iterator[Map]:
    """As mapped, with other signs, and in another order."""
    identity = Map.identity(dynamics.dof)
    for signs in product((1.0, -1.0), repeat=dynamics.dof):
        yield replace(identity, scale=signs)
    for order in permutations(identity.order):
        if order != identity.order:
            yield replace(identity, order=order)


def _maps(dynamics: Dynamics) -> Iterator[Map]:
    """The same, and as mapped in other units."""
    yield from _wirings(dynamics)
    for drives in _groups(dynamics):
        for factor in _units(dynamics, drives[0]):
            yield Map.identity(dynamics.dof).times(factor, drives)


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
            if best.clear:
                return


def _best_factor(dynamics: Dynamics, motion: Motion, drives: list[int]) -> Candidate | None:
    identity, linear = Map.identity(dynamics.dof), _units(dynamics, drives[0]) is SLIDING

    def closes(factor: float) -> bool:
        return closed_share(dynamics, motion, identity.times(factor, drives)) >= CLOSED

    grid = np.geomspace(_SMALLEST, _LONGEST if linear else _LARGEST, _CLOSING)
    closing = grid[[closes(float(factor)) for factor in grid]]
    if not closing.size:
        return None
    low, high = max(closing[0], closing[-1] / 30), closing[-1]
    grid = np.geomspace(low, high, _GRID)
    maps = (identity.times(float(factor), drives) for factor in grid)
    rough = next(iter(_likely(tried(dynamics, motion, maps, as_is=True))), None)
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
        lower, higher = (np.inf if trial is None else -trial.evidence for trial in trials)
        bend = lower + higher + 2 * best.evidence
        if np.isfinite(bend) and bend > 0:
            shift = float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))
            trials.append(times(step**shift))
        best = _likely([best, *filter(None, trials)])[0]
        step = float(np.sqrt(step))
    return best
