"""A series of sweeps of the contest of causes, until coefficients settle.

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
from deltaid.errors import KinematicsError
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.traces import Trace
from deltaid.identification.contest import Contest, contest, start
from deltaid.identification.contest_applied import with_effects, with_readings, without_contest
from deltaid.identification.contest_outcome import (
    beyond_parts,
    decided,
    doubted,
    is_settled,
    why_not,
)
from deltaid.identification.lags_and_gears import traced
from deltaid.identification.passive_turns import speed_errors
from deltaid.identification.setup import WIND_UP, Coefficients, ContestOutcome, Setup
from deltaid.levels import ROUNDS, SWEEPS, WIDER
from deltaid.recording.repairs import Gears

# Sweeps after which no effect is added any more: from then on sweeps only drop effects.
_DECIDED = 2
_OUT_OF_REACH = "the robot could not be in poses that it was recorded in"


@dataclass(frozen=True, eq=False)
class Sweeps:
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

    def counting(self, other: "Sweeps") -> "Sweeps":
        """The same with intervals that include the change of parameters by another end."""
        move = self.last.named(other.last.estimate - self.last.estimate)
        outcome = replace(self.outcome, moves=(*self.outcome.moves, move))
        setup = self.setup.changed(outcome=self.setup.outcome and outcome)
        return replace(self, setup=setup, outcome=outcome)


def sweeps(
    bare: Setup,
    barred: frozenset[str] = frozenset(),
    free: Sequence[UnknownEffect] = (),
    turns: tuple[float, ...] = (),
    *,
    may_wind_up: bool = True,
) -> Sweeps:
    """Sweep without the `barred` effects until coefficients settle or alternate or poses are out
    of reach, and judge the result; `free` are further effects, `turns` the first errors of the
    speeds of passive joints, and all errors behind compliant gears. With `may_wind_up`, gears may
    become compliant."""
    without = bare.changed(barred_effects=bare.barred_effects | barred)
    now, before, sweep, fast = without.all_repaired(turns=turns), _begun(bare), 0, turns
    full = _swept(now, before, traces_of(now), None, 0, free)
    if not turns and (turns := _first_turns(bare, before, full)):
        now = without.all_repaired(turns=turns)
        full = _swept(now, before, traces_of(now), None, 0, free)
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
            turns = _turns(bare, fast, last, after, before.values, after.read)
            now = with_readings(without, after, last.p).all_repaired(turns=turns)
            traces = traces_of(now)
            if not traces:
                why = "no row would be left whose links' motion is known"
                break
            before, full = after, _swept(now, after, traces, last.p, sweep, free)
        except KinematicsError:
            why = _OUT_OF_REACH
            break

    every = _allowed((*_unbarred(now, full.points[0]), *free), before, 0)
    whole = full.beside_dropped(every, before.read)
    kept = last if whole is full else whole.keeping(last.shrunk.candidates)
    end = Sweeps(
        bare, doubted(after, whole, kept), full, last, plain, (last.p - plain, *dismissed), parts,
        why, bool(why), bool(free),
    )  # fmt: skip
    return end if why else _judged(bare, end, fast)


def _judged(bare: Setup, end: Sweeps, fast: tuple[float, ...]) -> Sweeps:
    """With the kept effects applied, and why they are refuted; `fast` as of `_turns`."""
    setup, outcome, last = bare, end.outcome, end.last
    if outcome.kept or outcome.winds_up:
        try:
            turns = _turns(bare, fast, last, outcome, outcome.values, outcome.values)
        except KinematicsError:
            return replace(end, why_not=_OUT_OF_REACH, is_lost=True)
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
        return _turns(bare, (), last, after, before.values, before.read)
    except KinematicsError:
        return ()


def _turns(
    bare: Setup,
    fast: tuple[float, ...],
    last: Contest,
    after: ContestOutcome,
    before: dict[str, Coefficients],
    applied: dict[str, Coefficients],
) -> tuple[float, ...]:
    """`speed_errors` of the recordings as described; behind compliant gears `fast`, if any."""
    if fast and after.winds_up:
        return fast
    if not bare.dynamics.kinematics.passive_friction.names:
        return ()
    return speed_errors(traces_of(bare), last, after, before, applied)


def swept_beside(setup: Setup, own: UnknownEffect, instead_of: Collection[str]) -> Contest | None:
    """One sweep with the effect `own` in place of those named, nothing dropped; None where no
    recording can be differentiated."""
    bare = without_contest(setup)
    bare = bare.changed(barred_effects=bare.barred_effects | frozenset(instead_of))
    traces = traces_of(bare)
    return _swept(bare, _begun(bare), traces, None, 0, (own,)) if traces else None


def rows_of(setup: Setup) -> TraceRows:
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
    rows = rows_of(now)
    points = points_of(traces, start(rows, traces) if p is None else p)
    unknowns = _allowed((*_unbarred(now, points[0]), *more), before, sweep)
    return contest(rows, points, unknowns, before.read).with_cable(before.kept).with_ripples()


def _unbarred(setup: Setup, point: TracePoint) -> tuple[UnknownEffect, ...]:
    return tuple(u for u in unknowns_at(point) if u.name not in setup.barred_effects)


def _begun(bare: Setup) -> ContestOutcome:
    """The outcome before the first sweep, with the compliance of gears applied already."""
    wound = {WIND_UP: np.array(gears[0].compliance)} if (gears := gears_of(bare)) else {}
    return ContestOutcome(bare.robot, values=wound)


def gears_of(setup: Setup) -> list[Gears]:
    """The compliant gears of each recording that has them."""
    return [r.repairs.gears for r in setup.recordings if r.repairs.gears is not None]


def traces_of(setup: Setup) -> list[Trace]:
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
