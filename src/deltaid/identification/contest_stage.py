"""The stage of the contest of causes: sweeps until coefficients settle, then corrections.

Each sweep (`contest`) linearises all effects about the present estimate, drops those that the rows
do not need, and applies the others exactly to readings or robot. Some stay columns of the fit.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.all import UNKNOWNS, unknowns_at
from deltaid.effects.lag_columns import TimingColumns
from deltaid.effects.point import TracePoint, UnknownEffect, points_of
from deltaid.effects.unexplained import is_unexplained
from deltaid.errors import KinematicsError
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.scatter import NORMAL
from deltaid.estimation.traces import Trace
from deltaid.identification.contest import Contest, contest, start
from deltaid.identification.contest_applied import with_effects, with_readings, without_contest
from deltaid.identification.contest_outcome import (
    beyond_parts,
    decided,
    doubted,
    is_settled,
    overtaken,
    refuted,
    why_not,
)
from deltaid.identification.lags_and_gears import (
    estimated_anew,
    gears_turned_back,
    traced,
    usual_turns,
)
from deltaid.identification.passive_turns import speed_errors
from deltaid.identification.setup import (
    WIND_UP,
    Coefficients,
    ContestOutcome,
    Progress,
    Setup,
)
from deltaid.levels import ROUNDS, SWEEPS, WIDER
from deltaid.recording.repairs import Gears

# Sweeps after which no effect is added any more: from then on sweeps only drop effects.
_DECIDED = 2


@dataclass(frozen=True, eq=False)
class _Sweeps:
    """The end of a series of sweeps.

    Attributes:
        setup, outcome: with the kept effects.
        full: the last sweep.
        last: the last sweep, reduced to the kept effects.
        plain: parameters before any sweep.
        moves: changes of the parameters by the corrections, and by effects beyond their limits.
        parts: errors of the description that any sweep kept.
        why_not: why these corrections are refuted; empty where they stand.
        is_lost: whether the next sweep has poses out of reach, or no rows.
        is_beside_free: whether free functions of the drives' torques took part.
    """

    setup: Setup
    outcome: ContestOutcome
    full: Contest
    last: Contest
    plain: Parameters
    moves: tuple[Parameters, ...]
    parts: frozenset[str]
    why_not: str
    is_lost: bool
    is_beside_free: bool = False

    def counting(self, other: "_Sweeps") -> "_Sweeps":
        """The same with intervals that include the change of parameters by another end."""
        move = self.last.named(other.last.estimate - self.last.estimate)
        outcome = replace(self.outcome, moves=(*self.outcome.moves, move))
        setup = self.setup.changed(outcome=self.setup.outcome and outcome)
        return replace(self, setup=setup, outcome=outcome)


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
    if not _traces(bare):
        return setup
    return _contested(bare, progress).changed(barred_effects=setup.barred_effects)


def _contested(bare: Setup, progress: Progress) -> Setup:
    end, bare = _with_late(bare)
    others = [*_barred(bare, end.parts), *_from_stiff_gears(bare)] if end.why_not else []
    end = min((o for o in others if _is_better(o, end)), key=lambda o: o.last.noise, default=end)
    end = _beside_unexplained(bare, _without_windup(bare, end))
    outcome = end.outcome
    if not outcome.kept and (_gears(bare) or not outcome.winds_up):
        turns = end.setup.recordings[0].repairs.turns
        return bare.all_repaired(turns=turns).changed(outcome=outcome)
    if end.why_not:
        stiff = gears_turned_back(bare.changed(outcome=ContestOutcome(bare.robot)), progress)
        moves = [move for each in (end, *others) for move in each.moves]
        if _gears(bare):
            moves.append(_start(bare) - _start(stiff))
        return stiff.changed(outcome=refuted(outcome, end.why_not, moves))
    return estimated_anew(end.setup, progress)


def _with_late(bare: Setup) -> tuple[_Sweeps, Setup]:
    """Sweeps without the effects that take part late, or with them if the rows need any of them and
    they leave less noise; and the setup of these sweeps."""
    late = [u for u in UNKNOWNS if u.is_late and u.name not in bare.barred_effects]
    without = bare.changed(barred_effects=bare.barred_effects.union(u.name for u in late))
    end = _from_certain_turns(without)
    if not (late and end.full.needs(late)):
        return end, without
    beside = _from_certain_turns(bare)
    return (beside, bare) if _is_better(beside, end) else (end, without)


def _from_certain_turns(setup: Setup) -> _Sweeps:
    """Sweeps over all rows or, where these are refuted and passive joints have friction, sweeps
    that begin with rows in which these joints are fast."""
    end = _sweeps(setup)
    if not (end.why_not and (turns := usual_turns(setup))):
        return end
    from_fast = _sweeps(setup, turns=turns)
    return end if from_fast.why_not else from_fast


def _without_windup(bare: Setup, end: _Sweeps) -> _Sweeps:
    """Sweeps whose gears stay stiff, if they leave no more noise than sweeps in which gears became
    compliant beside other effects: far from the solution, a compliance may mimic any of these."""
    if _gears(bare) or not (end.outcome.winds_up and end.outcome.kept):
        return end
    stiff = _sweeps(bare, may_wind_up=False)
    if not _is_better(stiff, end):
        stiff = _beside_unexplained(bare, stiff, may_wind_up=False)
    return stiff if _is_better(stiff, end) else end


def _is_better(other: _Sweeps, end: _Sweeps) -> bool:
    """Whether other sweeps stand and leave no more noise, up to chance (95 %)."""
    chance = NORMAL * end.last.shrunk.noise_spread
    return not other.why_not and other.last.noise < end.last.noise + chance


def _beside_unexplained(bare: Setup, end: _Sweeps, *, may_wind_up: bool = True) -> _Sweeps:
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
    beside = _sweeps(stiff, free=free, may_wind_up=may_wind_up)
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


def _from_stiff_gears(bare: Setup) -> list[_Sweeps]:
    """Sweeps that begin without a compliance, if there is one: it takes more sweeps to vanish than
    to appear."""
    ends = [_sweeps(bare.all_repaired(gears=None))] if _gears(bare) else []
    return [end for end in ends if not end.is_lost]


def _barred(bare: Setup, parts: frozenset[str]) -> list[_Sweeps]:
    """Sweeps with none or only one of these errors of the description, least noise first."""
    all_but_one = [parts - {name} for name in sorted(parts)] if len(parts) > 1 else []
    ends = [_sweeps(bare, barred) for barred in (parts, *all_but_one) if barred]
    return sorted((end for end in ends if not end.is_lost), key=lambda end: end.last.noise)


def _sweeps(
    bare: Setup,
    barred: frozenset[str] = frozenset(),
    free: Sequence[UnknownEffect] = (),
    turns: tuple[float, ...] = (),
    *,
    may_wind_up: bool = True,
) -> _Sweeps:
    """Sweep without the `barred` effects until coefficients settle or alternate or poses are out
    of reach, and judge the result; `free` are further effects, `turns` the first errors of the
    speeds of passive joints, and all errors behind compliant gears. With `may_wind_up`, gears may
    become compliant."""
    without = bare.changed(barred_effects=bare.barred_effects | barred)
    now, before, sweep, fast = without.all_repaired(turns=turns), _begun(bare), 0, turns
    full = _swept(now, before, _traces(now), None, 0, free)
    if not turns and (turns := _first_turns(bare, before, full)):
        now = without.all_repaired(turns=turns)
        full = _swept(now, before, _traces(now), None, 0, free)
    plain, dismissed = full.points[0].p, ()
    parts, why, earlier = frozenset[str](), "", list[ContestOutcome]()
    while True:
        earlier.append(before)
        last = full.reduced()
        parts |= {u.name for u in UNKNOWNS if u.is_of_parts and u.name in last.shrunk.candidates}
        may = may_wind_up and sweep < _DECIDED
        after = decided(before, last, may_wind_up=may).within_limits()
        sweep += 1
        most = SWEEPS if after.winds_up else ROUNDS  # rows change with compliant gears
        if after.doubts != before.doubts:
            dismissed = (*dismissed, last.p - plain)
            sweep, earlier = 0, list[ContestOutcome]()  # others may take part instead
        elif sweep == most or any(is_settled(outcome, after) for outcome in earlier):
            break
        try:
            turns = fast if after.winds_up else ()
            turns = turns or _turns(bare, last, after, before.values, after.read)
            now = with_readings(without, after, last.p).all_repaired(turns=turns)
            traces = _traces(now)
            if not traces:
                why = "no row would be left whose links' motion is known"
                break
            before, full = after, _swept(now, after, traces, last.p, sweep, free)
        except KinematicsError:
            why = "the robot could not be in poses that it was recorded in"
            break

    every = _allowed((*_unbarred(now, full.points[0]), *free), before, 0)
    whole = full.beside_dropped(every, before.read)
    kept = last if whole is full else whole.keeping(last.shrunk.candidates)
    end = _Sweeps(
        bare, doubted(after, whole, kept), full, last, plain, (last.p - plain, *dismissed), parts,
        why, bool(why), bool(free),
    )  # fmt: skip
    return end if why else _judged(bare, end, fast)


def _judged(bare: Setup, end: _Sweeps, fast: tuple[float, ...]) -> _Sweeps:
    """With the kept effects applied, and why they are refuted; `fast` are errors of the speeds of
    passive joints behind compliant gears."""
    setup, outcome, last = bare, end.outcome, end.last
    if outcome.kept or outcome.winds_up:
        turns = fast if outcome.winds_up else ()
        turns = turns or _turns(bare, last, outcome, outcome.values, outcome.values)
        now = with_readings(bare, outcome, last.p).all_repaired(turns=turns)
        setup = with_effects(now, outcome, last)
    return replace(end, setup=setup, why_not=why_not(setup, beyond_parts(last)))


def _first_turns(bare: Setup, before: ContestOutcome, first: Contest) -> tuple[float, ...]:
    """`_turns` by the corrections of a first sweep; empty where these put poses out of reach."""
    if not bare.dynamics.kinematics.passive_friction.names:
        return ()
    last = first.reduced()
    try:
        after = decided(before, last, may_wind_up=False)
        return _turns(bare, last, after, before.values, before.read)
    except KinematicsError:
        return ()


def _turns(
    bare: Setup,
    last: Contest,
    after: ContestOutcome,
    before: dict[str, Coefficients],
    applied: dict[str, Coefficients],
) -> tuple[float, ...]:
    """`speed_errors` of the recordings as described."""
    if not bare.dynamics.kinematics.passive_friction.names:
        return ()
    return speed_errors(_traces(bare), last, after, before, applied)


def swept_beside(setup: Setup, own: UnknownEffect, instead_of: Collection[str]) -> Contest | None:
    """One sweep with the effect `own` in place of those named, nothing dropped; None where no
    recording can be differentiated."""
    bare = without_contest(setup)
    bare = bare.changed(barred_effects=bare.barred_effects | frozenset(instead_of))
    traces = _traces(bare)
    return _swept(bare, _begun(bare), traces, None, 0, (own,)) if traces else None


def _start(setup: Setup) -> Parameters:
    """Parameters before any effect of a contest is known."""
    return start(_rows(setup), _traces(setup))


def _rows(setup: Setup) -> TraceRows:
    # With narrow priors, effects would explain rows that contradict one; the fit widens these.
    spread = WIDER * setup.settings.prior_spread
    return TraceRows.for_dynamics(setup.dynamics, setup.without(TimingColumns).additions, spread)


def _swept(
    now: Setup,
    before: ContestOutcome,
    traces: Sequence[Trace],
    p: Parameters | None,
    sweep: int,
    more: Sequence[UnknownEffect] = (),
) -> Contest:
    """One sweep about the recordings as corrected so far."""
    rows = _rows(now)
    points = points_of(traces, start(rows, traces) if p is None else p)
    unknowns = _allowed((*_unbarred(now, points[0]), *more), before, sweep)
    return contest(rows, points, unknowns, before.read).with_cable(before.kept).with_ripples()


def _unbarred(setup: Setup, point: TracePoint) -> tuple[UnknownEffect, ...]:
    return tuple(u for u in unknowns_at(point) if u.name not in setup.barred_effects)


def _begun(bare: Setup) -> ContestOutcome:
    """The outcome before the first sweep, with the compliance of gears applied already."""
    wound = {WIND_UP: np.array(gears[0].compliance)} if (gears := _gears(bare)) else {}
    return ContestOutcome(bare.robot, values=wound)


def _gears(setup: Setup) -> list[Gears]:
    """The compliant gears of each recording that has them."""
    return [r.repairs.gears for r in setup.recordings if r.repairs.gears is not None]


def _traces(setup: Setup) -> list[Trace]:
    """Traces of recordings without an undeclared load."""
    pairs = zip(setup.recordings, setup.disturbed, strict=True)
    traces = (traced(setup, r, r.cutoff) for r, is_disturbed in pairs if not is_disturbed)
    return [trace for trace in traces if trace is not None]


def _allowed(
    unknowns: Sequence[UnknownEffect], before: ContestOutcome, sweep: int
) -> tuple[UnknownEffect, ...]:
    """Effects that take part: not those beyond their limits, and in later sweeps only kept ones."""
    late = sweep >= _DECIDED
    return tuple(
        unknown for unknown in unknowns
        if not unknown.is_candidate or not (
            (late and unknown.name not in before.kept)
            or unknown.name in before.doubts
        )
    )  # fmt: skip
