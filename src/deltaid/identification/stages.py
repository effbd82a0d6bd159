"""All stages that correct recordings and description before the fit, in their order, and the terms
and effects that the fit puts at zero.

Friction laws are chosen by rows with free lags, but the fit may hold lags: a term that explained a
lag is then at its bound, and a law without it is chosen instead. An effect that others have made
needless is removed likewise.
"""

from typing import NamedTuple

import numpy as np

from deltaid.effects.along_motion import AlongMotion
from deltaid.effects.at_drives import RippleColumns
from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import RecordingError
from deltaid.estimation.additions import split_by_addition
from deltaid.estimation.scatter import NORMAL, surprise
from deltaid.identification.column_stages import (
    holds_filled,
    late_rates_excluded,
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
from deltaid.identification.uncertainty import covariance, uncertainty
from deltaid.identification.warmth import changing_friction
from deltaid.identification.whole_loads import loads_of_whole_recordings
from deltaid.model.parameter_record import JointTerm


def recordings_studied(setup: Setup, progress: Progress) -> Setup:
    """Study the residual of each recording before lags and friction are corrected."""
    progress("looking at what the description leaves")
    return setup.studied()


def gears_searched(setup: Setup, progress: Progress) -> Setup:
    """Search compliant gears, unless they have been found instead of play: another search misses
    these without the rows that they exclude."""
    is_known = any(recording.repairs.gears for recording in setup.recordings)
    return setup if is_known else gears_turned_back(setup, progress)


def wound_up_instead_of_play(setup: Setup, progress: Progress) -> Setup:
    """Replace play by compliant gears where these leave no play: with either, a motor runs ahead of
    its link, most of all where the gear's torque changes its sign.

    Compliant gears look like lags as well, so lags are estimated again after them.
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


def events_anew(setup: Setup, progress: Progress) -> Setup:
    """Detect events again beside effects that looked like some before the contest."""
    brief = [a for a in setup.additions if isinstance(a, AlongMotion) and a.looks_like_events]
    return without_events(setup, progress) if brief else setup


def sharpened(setup: Setup, progress: Progress) -> Setup:
    """Raise the cut-off to that of the choice of friction laws, if a law has a term near rest or
    torques saturate.

    Stribeck friction lasts some milliseconds at each reversal; with the usual cut-off it looks like
    Coulomb's. Torques between two saturations may be as brief, and their course alone separates
    inertia from friction. The last stage: all others use the usual cut-off.
    """
    is_brief = any(law.stribeck or law.hess_soom for law in setup.robot.friction.values()) or any(
        mask.reason == "saturated torque"
        for recording in setup.recordings
        for mask in recording.log.masks
    )
    if setup.settings.cutoff is not None or not is_brief:
        return setup
    try:
        # Motion behind compliant gears has noise of torques, which grows with frequency.
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
    late_rates_excluded,
    declared_loads,
    without_events,
    wound_up_instead_of_play,
    recordings_studied,
    gains,
    lags_corrected,
    gears_searched,
    loads_of_whole_recordings,
    undeclared_loads,
    contested,
    events_anew,
    changing_friction,
    chosen_friction,
    changing_friction,
    lags_corrected,
    gains,
    sensors_settled,
    sharpened,
)


def run_stages(
    setup: Setup, progress: Progress, *, first: Stage = STAGES[0], before: Stage | None = None
) -> Setup:
    """A setup after the stages from `first` on, all or those `before` another one."""
    stop = None if before is None else STAGES.index(before)
    for stage in STAGES[STAGES.index(first) : stop]:
        setup = stage(setup, progress)
    return setup


class Idle(NamedTuple):
    """Friction terms and effects that a fit does not need."""

    terms: frozenset[JointTerm] = frozenset()
    effects: frozenset[str] = frozenset()


def idle(setup: Setup, problem: FittedProblem) -> Idle:
    """Chosen friction terms and effects along the motion whose coefficients may all be zero at
    once, and detected loads whose mass may be. Ripples are always needed: their orders are beyond
    chance."""
    steps = setup.friction_choice.steps if setup.friction_choice else ()
    chosen = {(step.joint, step.addition) for step in steps if step.useful}
    terms = {
        (term.joint, term.kind): problem.layout.names.index(term.name)
        for term in problem.dynamics.robot.friction_terms
        if (term.joint, term.kind) in chosen
    }
    values, first = problem.values.copy(), len(problem.p)
    effects: dict[str, list[int]] = {}
    for addition, places in split_by_addition(problem.additions, range(first, len(values))):
        if isinstance(addition, AlongMotion) and not isinstance(addition, RippleColumns):
            effects[addition.name] = list(places)
        elif isinstance(addition, LoadColumns) and addition.is_detected:
            values[places[0]] += addition.taken[0]
            effects[addition.load.name] = [places[0]]
    if not (terms or effects):
        return Idle()
    free = freed(problem)

    def may_be_zero(places: list[int]) -> bool:
        """Whether χ² of all values together stays within its 95 % quantile: the square of their
        combination that is farthest from zero, in its own standard deviations."""
        if not values[places].any():
            return True
        farthest = np.zeros(len(values))
        farthest[places] = np.linalg.solve(covariance(free, places), values[places])
        distance = float(farthest @ values) / uncertainty(free, farthest[None]).std[0]
        return surprise(distance**2, len(places)) < surprise(NORMAL**2, 1)

    return Idle(
        frozenset(term for term, place in terms.items() if may_be_zero([place])),
        frozenset(name for name, places in effects.items() if may_be_zero(places)),
    )
