"""Search for the hypotheses about position and torque columns that explain a recording.

A hypothesis maps position columns: another sign, order or unit, or positions of motors behind
undeclared gears, with the factor that explains the torques best.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, permutations, product
from operator import attrgetter

import numpy as np
from jaxtyping import Bool

from deltaid.checks.wiring.candidate import (
    CLOSED,
    JUDGED,
    LITTLE,
    MOSTLY_CLOSED,
    SLIDING,
    Assignment,
    WiringHypothesis,
    as_good,
    closed_shares,
    named_units,
    residuals,
    tried,
)
from deltaid.checks.wiring.residual import FilteredMotion, Map, residual
from deltaid.dynamics.dynamics import Dynamics

# Number of samples that hypotheses are tried on, and of hypotheses that are fitted.
SAMPLES, _FITTED = 120, 16
# Range of motor position factors, and number of them whose loops are tried.
SMALLEST, _LARGEST, _CLOSING = 1 / 3000, 1 / 1.5, 48
# Longest lead of a linear drive [m per rad]: half a metre per revolution.
_LONGEST = 0.5 / (2 * np.pi)
# Step by which the factor of the best hypothesis is refined.
_FINE = 1.04
_EVIDENCE = attrgetter("evidence")


def explained(
    dynamics: Dynamics, fine: FilteredMotion, coarse: FilteredMotion
) -> tuple[WiringHypothesis, ...]:
    """The hypotheses that explain a recording as well as the best one, simplest first.

    The first is the mapping itself unless another is clearly better; none if no loops close.

    Args:
        fine: motion for the decision.
        coarse: a part of it for the search.
    """
    identity = Map.identity(dynamics.dof)
    as_is = residual(dynamics, fine, identity)
    mapped = [WiringHypothesis(as_is, identity.order, np.ones(dynamics.dof))] if as_is else []
    likely = _searched(dynamics, fine, coarse.few(SAMPLES), settled=any(c.clear for c in mapped))
    if likely is None:
        return tuple(mapped)
    solved = {under.map: under for under in residuals(dynamics, fine, {t.map for t in likely})}
    fitted = (replace(t, residual=solved[t.map]) for t in likely if t.map in solved)
    keys = [trial.key for trial in mapped]
    examined = [c for c in fitted if c.key not in keys and c.sensible] + mapped
    best = max(examined, key=lambda trial: trial.fit.score, default=None)
    good = [trial for trial in examined if best is not None and trial.as_likely_as(best)]
    for as_mapped in mapped:
        if as_mapped.residual.share >= MOSTLY_CLOSED:
            good = [trial for trial in good if trial.beats(as_mapped)] or [as_mapped]
    return tuple(sorted(good, key=attrgetter("complexity")))


def _searched(
    dynamics: Dynamics, fine: FilteredMotion, coarse: FilteredMotion, *, settled: bool
) -> list[WiringHypothesis] | None:
    """The likeliest hypotheses from a part of a recording, simplest first; if units need no search
    (`settled`), None if none is likelier than the mapping."""
    wirings = _wirings(dynamics) if settled else chain(_wirings(dynamics), _in_units(dynamics))
    maps = (map for map in wirings if _decidable(map, fine.moves))
    trials = _likely(tried(dynamics, coarse, maps))
    if settled:
        as_is = next((trial.evidence for trial in trials if trial.changes == 0), -np.inf)
        if not trials or trials[0].evidence - as_is < as_good(len(trials[0].residual.Y)):
            return None
    trials = _ranked(trials)
    if not trials or trials[0].unexplained > LITTLE or trials[0].map.scaled:
        trials = _ranked([*trials, *_of_motors(dynamics, coarse)])
        if trials and trials[0].map.scaled:
            trials = _ranked([*trials, _narrowed(dynamics, coarse, trials[0], _FINE)])
    return sorted((t for t in trials if t.as_likely_as(trials[0])), key=attrgetter("complexity"))[
        :JUDGED
    ]


def together(
    dynamics: Dynamics,
    motions: Sequence[FilteredMotion],
    each: Sequence[tuple[WiringHypothesis, ...]],
) -> tuple[tuple[WiringHypothesis, ...], ...]:
    """The hypotheses that explain several recordings with one wiring as well as the best one, for
    each recording; log likelihoods add up.

    Args:
        each: the hypotheses for each recording by itself.
    """
    if all(good[0].changes == 0 for good in each):
        return tuple(each)
    identity = Map.identity(dynamics.dof)
    keys = dict.fromkeys(candidate.key for good in each for candidate in good)
    keys[identity, identity.order, identity.scale] = None
    posed = [_posed(dynamics, motion, keys) for motion in motions]
    trials = {key: [fits[key] for fits in posed if key in fits] for key in keys}
    scores = {key: sum(trial.fit.score for trial in trials[key]) for key in keys}
    best = max(keys, key=lambda key: scores[key])
    margin = as_good(sum(len(trial.residual.Y) for trial in trials[best]))
    good = [key for key in keys if scores[best] - scores[key] < margin]
    good.sort(key=lambda key: min(trial.complexity for trial in trials[key]))
    return tuple(tuple(fits[key] for key in good if key in fits) for fits in posed)


def _posed(
    dynamics: Dynamics, motion: FilteredMotion, assignments: Iterable[Assignment]
) -> dict[Assignment, WiringHypothesis]:
    """Assignments as hypotheses about a motion, where enough of its samples have poses."""
    solved = {map: residual(dynamics, motion, map) for map, *_ in assignments}
    return {
        (map, order, gains): WiringHypothesis(under, order, np.array(gains))
        for map, order, gains in assignments
        if (under := solved[map]) is not None
    }


def _decidable(map: Map, moves: Bool[np.ndarray, " drives"]) -> bool:
    """Whether it changes only moving columns: at rest sign, unit and drive are undetermined."""
    moved = [a != i or f != 1 for i, (a, f) in enumerate(zip(map.order, map.scale, strict=True))]
    return bool(moves[moved].all()) or (all(moved) and len(set(map.scale)) == 1)


def _likely(candidates: Iterable[WiringHypothesis]) -> list[WiringHypothesis]:
    """Hypotheses worth fitting with a consistent robot, likeliest first.

    Identical limbs make several assignments equal: of those as good as the best, the simplest are
    fitted.
    """
    ranked = sorted(candidates, key=lambda candidate: -candidate.evidence)
    margin = as_good(len(ranked[0].residual.Y)) if ranked else 0.0
    first = [trial for trial in ranked if trial.evidence > ranked[0].evidence - margin]
    first.sort(key=attrgetter("complexity"))
    fitted = [*first, *ranked[len(first) :]][:_FITTED]
    return sorted(fitted, key=lambda candidate: -candidate.evidence)


def _ranked(candidates: Iterable[WiringHypothesis]) -> list[WiringHypothesis]:
    return sorted(candidates, key=lambda candidate: -candidate.fit.score)


def _wirings(dynamics: Dynamics) -> Iterator[Map]:
    identity = Map.identity(dynamics.dof)
    for signs in product((1.0, -1.0), repeat=dynamics.dof):
        yield replace(identity, scale=signs)
    for order in permutations(identity.order):
        if order != identity.order:
            yield replace(identity, order=order)


def _in_units(dynamics: Dynamics) -> Iterator[Map]:
    for drives in _groups(dynamics):
        for factor in named_units(dynamics.robot, drives[0]):
            yield Map.identity(dynamics.dof).times(factor, drives)


def _groups(dynamics: Dynamics) -> Iterator[list[int]]:
    """Drives that may share a fault: all of a kind, or each alone, except a telescope's, whose unit
    loops do not determine."""
    linear = dynamics.robot.linear_drives
    for kind in sorted(set(linear)):
        same = [i for i, slides in enumerate(linear) if slides == kind]
        if len(same) > 1:
            yield same
    yield from ([i] for i in range(dynamics.dof if dynamics.robot.telescope is None else 3))


def _of_motors(dynamics: Dynamics, motion: FilteredMotion) -> Iterator[WiringHypothesis]:
    """Positions of motors, by the factor that explains the torques best."""
    for drives in _groups(dynamics):
        best = _best_factor(dynamics, motion, drives)
        if best is not None:
            yield best
            if best.clear:
                return


def _best_factor(
    dynamics: Dynamics, motion: FilteredMotion, drives: list[int]
) -> WiringHypothesis | None:
    """Hypothesis with the best factor of these drives' positions; None if no loops close, or beyond
    any lead."""
    identity = Map.identity(dynamics.dof)
    longest = _LONGEST if named_units(dynamics.robot, drives[0]) is SLIDING else np.inf
    grid = np.geomspace(SMALLEST, min(longest, _LARGEST), _CLOSING)
    scaled = [identity.times(factor, drives) for factor in grid.tolist()]
    closing = grid[closed_shares(dynamics, motion, scaled) >= CLOSED].tolist()
    if not closing:
        return None
    grid = np.geomspace(max(closing[0], closing[-1] / 30), closing[-1], _FITTED).tolist()
    trials = (identity.times(factor, drives) for factor in grid)
    rough = max(tried(dynamics, motion, trials, as_is=True), key=_EVIDENCE, default=None)
    best = rough and _narrowed(dynamics, motion, rough, grid[1] / grid[0])
    return None if best is None or abs(best.map.scale[drives[0]]) > longest else best


def _narrowed(
    dynamics: Dynamics, motion: FilteredMotion, best: WiringHypothesis, step: float
) -> WiringHypothesis:
    """The best factor of the scaled positions, from a rough one, by parabolas."""

    def times(by: float) -> WiringHypothesis | None:
        map = best.map.times(by, best.map.scaled)
        return next(tried(dynamics, motion, [map], as_is=True), None)

    for _ in range(3):
        trials = [times(1 / step), times(step)]
        lower, higher = (np.inf if trial is None else -trial.evidence for trial in trials)
        bend = lower + higher + 2 * best.evidence
        if np.isfinite(bend) and bend > 0:
            trials.append(times(step ** float(np.clip(0.5 * (lower - higher) / bend, -1.5, 1.5))))
        best = max([best, *filter(None, trials)], key=_EVIDENCE)
        step = float(np.sqrt(step))
    return best
