"""The stage of the contest of causes.

Of several series of sweeps (`contest_sweeps`) from different beginnings, one decides what is
corrected.
"""

from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.all import UNKNOWNS
from deltaid.effects.unexplained import is_unexplained
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.contest import start
from deltaid.identification.contest_applied import without_contest
from deltaid.identification.contest_outcome import overtaken, refuted
from deltaid.identification.contest_sweeps import Sweeps, gears_of, rows_of, sweeps, traces_of
from deltaid.identification.lags_and_gears import estimated_anew, gears_turned_back, usual_turns
from deltaid.identification.setup import ContestOutcome, Progress, Setup


def contested(setup: Setup, progress: Progress) -> Setup:
    """Correct the effects that the rows need beside all others, unless that has been done.

    The first slopes are taken far from the solution, where one error of the description may mimic
    the curvature of another. So after a refuted result, sweeps are repeated without such errors and
    from stiff gears; the best replaces the first if it leaves as little noise. Where torque is
    unexplained, sweeps with free functions of the drives' torques replace the result if the rows
    are more probable with them.
    """
    if setup.settings.effects == "none" or setup.outcome:
        return setup
    progress("weighing causes against each other")
    bare = without_contest(setup)
    if not traces_of(bare):
        return setup
    return _contested(bare, progress).changed(barred_effects=setup.barred_effects)


def _contested(bare: Setup, progress: Progress) -> Setup:
    end, bare = _with_late(bare)
    others = [*_barred(bare, end.parts), *_from_stiff_gears(bare)] if end.why_not else []
    end = min((o for o in others if _is_better(o, end)), key=lambda o: o.last.noise, default=end)
    end = _beside_unexplained(bare, _without_windup(bare, end))
    outcome = end.outcome
    if not outcome.kept and (gears_of(bare) or not outcome.winds_up):
        turns = end.setup.recordings[0].repairs.turns
        return bare.all_repaired(turns=turns).changed(outcome=outcome)
    if end.why_not:
        stiff = gears_turned_back(bare.changed(outcome=ContestOutcome(bare.robot)), progress)
        moves = [move for each in (end, *others) for move in each.moves]
        if gears_of(bare):
            moves.append(_start(bare) - _start(stiff))
        return stiff.changed(outcome=refuted(outcome, end.why_not, moves))
    return estimated_anew(end.setup, progress)


def _with_late(bare: Setup) -> tuple[Sweeps, Setup]:
    """Sweeps without the effects that take part late, or with them if the rows need any of them and
    they leave less noise; and the setup of these sweeps, also for further ones if both are
    refuted."""
    late = [u for u in UNKNOWNS if u.is_late and u.name not in bare.barred_effects]
    without = bare.changed(barred_effects=bare.barred_effects.union(u.name for u in late))
    end = _from_certain_turns(without)
    if not (late and end.full.needs(late)):
        return end, without
    beside = _from_certain_turns(bare)
    is_quieter = beside.last.noise < end.last.noise
    take_part = is_quieter if beside.why_not and end.why_not else _is_better(beside, end)
    return (beside, bare) if take_part else (end, without)


def _from_certain_turns(setup: Setup) -> Sweeps:
    """Sweeps over all rows or, where these are refuted and passive joints have friction, sweeps
    that begin with rows in which these joints are fast, if those stand and halve the noise: then
    most of it is of reversals elsewhere than described."""
    end = sweeps(setup)
    if not (end.why_not and (turns := usual_turns(setup))):
        return end
    from_fast = sweeps(setup, turns=turns)
    is_explained = from_fast.last.noise < end.last.noise - np.log(2.0)
    return from_fast if is_explained and not from_fast.why_not else end


def _without_windup(bare: Setup, end: Sweeps) -> Sweeps:
    """Sweeps whose gears stay stiff, if they leave no more noise than sweeps in which gears became
    compliant beside other effects: far from the solution, a compliance may mimic any of these."""
    if gears_of(bare) or not (end.outcome.winds_up and end.outcome.kept):
        return end
    stiff = sweeps(bare, may_wind_up=False)
    if not _is_better(stiff, end):
        stiff = _beside_unexplained(bare, stiff, may_wind_up=False)
    return stiff if _is_better(stiff, end) else end


def _is_better(other: Sweeps, end: Sweeps) -> bool:
    """Whether other sweeps stand and leave no more noise, up to chance (95 %)."""
    chance = NORMAL * end.last.shrunk.noise_spread
    return not other.why_not and other.last.noise < end.last.noise + chance


def _beside_unexplained(bare: Setup, end: Sweeps, *, may_wind_up: bool = True) -> Sweeps:
    """Sweeps with free functions of the drives' torques, if the rows need these, leave less noise
    and are more probable, or only the others are refuted; intervals include the other end. Where
    they end without such functions, these have led to another end, which must leave less noise
    beyond chance (95 %).

    These sweeps begin with stiff gears: an earlier compliance may be a part of the unexplained
    torque, and takes more sweeps to vanish than to appear.
    """
    if end.is_beside_free or not (free := end.full.unexplained()):
        return end
    stiff = bare if bare.robot.gear_stiffness else bare.all_repaired(gears=None)
    beside = sweeps(stiff, free=free, may_wind_up=may_wind_up)
    is_free = any(map(is_unexplained, beside.outcome.kept))  # or free functions only led there
    least = end.last.noise
    if is_free:
        beside = replace(beside, why_not=beside.why_not or overtaken(end.last, beside.last))
    else:
        least -= NORMAL * end.last.shrunk.noise_spread
    if is_free and bool(end.why_not) == bool(beside.why_not):
        is_better = end.full.prefers(beside.last, end.last)
    else:
        is_better = not beside.why_not
    stands = is_better and beside.last.noise < least
    return beside.counting(end) if stands else end.counting(beside)


def _from_stiff_gears(bare: Setup) -> list[Sweeps]:
    """Sweeps that begin without a compliance, if there is one: it takes more sweeps to vanish than
    to appear."""
    ends = [sweeps(bare.all_repaired(gears=None))] if gears_of(bare) else []
    return [end for end in ends if not end.is_lost]


def _barred(bare: Setup, parts: frozenset[str]) -> list[Sweeps]:
    """Sweeps with none or only one of these errors of the description, least noise first."""
    all_but_one = [parts - {name} for name in sorted(parts)] if len(parts) > 1 else []
    ends = [sweeps(bare, barred) for barred in (parts, *all_but_one) if barred]
    return sorted((end for end in ends if not end.is_lost), key=lambda end: end.last.noise)


def _start(setup: Setup) -> Parameters:
    """Parameters before any effect of a contest is known."""
    return start(rows_of(setup), traces_of(setup))
