"""All steps that correct recordings and description before they are fitted, in their order; and
what of their corrections the final fit puts at zero.

Laws are chosen by rows in which lags are free, and a fit may hold them: what explained a lag there
is then at its bound. A law that does without such a term is chosen instead. So is a fit without an
effect that others have made needless.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deltaid.effects.along_motion import AlongMotion, RippleColumns
from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import RecordingError
from deltaid.estimation.additions import of_each
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.column_stages import (
    holds_filled,
    late_rates_left_out,
    sensors_included,
    sensors_settled,
)
from deltaid.identification.contest_stage import contested
from deltaid.identification.events import is_play, without_events, without_play
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_choice import chosen_friction
from deltaid.identification.friction_constants import freed
from deltaid.identification.friction_rows import cutoff_of
from deltaid.identification.gains import gains
from deltaid.identification.lags_and_gears import gears_turned_back, lags_corrected
from deltaid.identification.loads import declared_loads, undeclared_loads
from deltaid.identification.setup import Progress, Setup, Stage
from deltaid.identification.uncertainty import uncertainty
from deltaid.identification.warmth import changing_friction
from deltaid.model.parameter_record import JointTerm


def recordings_studied(setup: Setup, progress: Progress) -> Setup:
    """Which causes the residual of each recording has, before lags and friction are corrected."""
    progress("looking at what the description leaves")
    return setup.studied()


def gears_searched(setup: Setup, progress: Progress) -> Setup:
    """Gears turned back; those that were taken for play stay, for another search misses them
    without the rows that are excluded behind them."""
    is_known = any(recording.repairs.gears for recording in setup.recordings)
    return setup if is_known else gears_turned_back(setup, progress)


def wound_up_instead_of_play(setup: Setup, progress: Progress) -> Setup:
    """Without play where gears that wind up leave none: a motor runs ahead of its link with either,
    most of all where the torque that the gear carries changes its sign.

    Gears that wind up look like lags as well, so these are known again once the gears are.
    """
    if not any(is_play(recording) for recording in setup.recordings):
        return setup
    whole = without_play(setup)
    for start in (whole.all_repaired(delay=()), whole):
        wound = gears_turned_back(start, progress)
        if not any(recording.repairs.gears for recording in wound.recordings):
            continue
        judged = without_events(wound, progress)
        if not any(is_play(recording) for recording in judged.recordings):
            return judged
    return setup


def sharpened(setup: Setup, progress: Progress) -> Setup:
    """Rows that friction laws were chosen by, where a law has a term for friction near rest.

    Stribeck's lasts some milliseconds at each reversal; rows that keep no more than the motion asks
    for confuse it with Coulomb's. The last stage: all others judge by the rows before.
    """
    laws = setup.robot.friction.values()
    if setup.settings.cutoff is not None or not any(law.stribeck or law.hess_soom for law in laws):
        return setup
    try:
        # Links behind gears that wind up have the torques' noise, more of it the faster.
        recordings = (
            recording.changed(cutoff_of(recording))
            if recording.low_pass and recording.repairs.gears is None
            else recording
            for recording in setup.recordings
        )
        return setup.changed(recordings=tuple(recordings))
    except RecordingError:
        return setup  # too short for a filter of that length


STAGES: tuple[Stage, ...] = (
    sensors_included,
    holds_filled,
    late_rates_left_out,
    declared_loads,
    without_events,
    wound_up_instead_of_play,
    recordings_studied,
    gains,
    lags_corrected,
    gears_searched,
    undeclared_loads,
    contested,
    changing_friction,
    chosen_friction,
    changing_friction,
    lags_corrected,
    gains,
    sensors_settled,
    sharpened,
)


def after(setup: Setup, stages: Sequence[Stage], progress: Progress) -> Setup:
    """A setup after some stages."""
    for stage in stages:
        setup = stage(setup, progress)
    return setup


def before_contest(setup: Setup, progress: Progress) -> Setup:
    """A setup after the stages before causes are weighed against each other."""
    return after(setup, STAGES[: STAGES.index(contested)], progress)


def before_laws(setup: Setup, progress: Progress) -> Setup:
    """A setup after the stages before friction laws are chosen, which no barred term changes."""
    return after(setup, STAGES[: STAGES.index(chosen_friction)], progress)


def with_laws(setup: Setup, progress: Progress) -> Setup:
    """The same after all others."""
    return after(setup, STAGES[STAGES.index(chosen_friction) :], progress)


class Idle(NamedTuple):
    """What a fit has no use for."""

    terms: frozenset[JointTerm] = frozenset()
    effects: frozenset[str] = frozenset()


def idle(setup: Setup, problem: FittedProblem) -> Idle:
    """Chosen terms of one coefficient, and effects along the motion of any number, whose
    coefficients may all be zero; and detected loads whose mass may be.

    No ripples: each has an order of its own, which was searched because it is beyond chance.
    """
    steps = setup.friction_choice.steps if setup.friction_choice else ()
    chosen = {(step.joint, step.addition) for step in steps if step.useful}
    terms = {
        (term.joint, term.kind): problem.layout.names.index(term.name)
        for term in problem.dynamics.robot.friction_terms
        if (term.joint, term.kind) in chosen
    }
    values, first = problem.values.copy(), len(problem.p)
    effects: dict[str, list[int]] = {}
    for addition, places in of_each(problem.additions, range(first, len(values))):
        if isinstance(addition, AlongMotion) and not isinstance(addition, RippleColumns):
            effects[addition.name] = list(places)
        elif isinstance(addition, LoadColumns) and addition.is_detected:
            values[places[0]] += addition.taken[0]
            effects[addition.load.name] = [places[0]]
    if not (terms or effects):
        return Idle()
    may_be_zero = np.abs(values) < NORMAL * uncertainty(freed(problem)).std
    return Idle(
        frozenset(term for term, k in terms.items() if may_be_zero[k]),
        frozenset(name for name, places in effects.items() if all(may_be_zero[places])),
    )
