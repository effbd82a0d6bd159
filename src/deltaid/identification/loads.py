"""Stages for loads: estimated roughly before the fit, with it, and reported after it.

Torques of the rough p_L are subtracted from the recordings, so that other stages see the robot
alone; the columns of the fit (`effects.load_columns`) have the remaining part of p_L.

An undeclared load that comes and goes is identified as if declared, at the times that a study
detects. So all of the recording determines the robot without it; a verdict reports the load.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.all import effect_of
from deltaid.effects.effect import Cause, causes_of
from deltaid.effects.load_columns import LoadColumns, Ten
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition, extended, split_by_addition
from deltaid.estimation.objective import pose
from deltaid.estimation.reduction import build_reduction
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.contest_stage import contested
from deltaid.identification.events import with_events, without_events
from deltaid.identification.gathering import gather_all
from deltaid.identification.lags_and_gears import estimated_anew
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.sources import model_filtered
from deltaid.identification.study import (
    ADEQUATE,
    LOAD_CHANGE,
    Study,
    left_of_a_drive,
    studied,
)
from deltaid.model.model import Model
from deltaid.model.parameter_record import HeldLoad, Parameter
from deltaid.recording.carried import Load
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import LOAD_CHANGES, joined_times
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.recording.repairs import LeftSpan

# Longest recording that is searched for a load's times [s]: its rows are held in memory.
_LONGEST = 600.0

# Name of each recording, for messages, and the loads that it holds.
HeldLoads = Sequence[tuple[str, Sequence[Load]]]


def held_loads(recordings: Sequence[PreparedRecording]) -> HeldLoads:
    return [(str(recording.path), recording.log.columns.loads) for recording in recordings]


def joined_loads(holding: HeldLoads) -> tuple[Load, ...]:
    """The loads of recordings, one of each name, with everything declared about it.

    Raises:
        RecordingError: two recordings contradict each other on one load.
    """
    loads: dict[str, Load] = {}
    for where, declared in holding:
        for load in declared:
            before = loads.setdefault(load.name, load)
            for key, value in load.known.items():
                if before.known.get(key, value) != value:
                    raise RecordingError(
                        f"load {load.name} has another {key} than in the recording before",
                        where=where,
                        cure="say the same of it everywhere, or give two loads two names",
                    )
            loads[load.name] = before.changed(**load.known)
    return tuple(loads.values())


def declared_loads(setup: Setup, progress: Progress) -> Setup:
    """Subtract declared loads, as known or roughly estimated."""
    loads = joined_loads(held_loads(setup.recordings))
    if not loads:
        return setup
    progress("estimating what the robot carries")
    setup = setup.without(LoadColumns)
    dynamics, spread = setup.dynamics, setup.settings.prior_spread
    columns = [
        LoadColumns(dynamics, load, spread, np.zeros(10), load.name in setup.detected)
        for load in loads
    ]
    rough = _rough(setup, columns)
    taken = {load.name: p for load, p in zip(loads, rough, strict=True)}
    additions = (replace(column, taken=p) for column, p in zip(columns, rough, strict=True))
    recordings = tuple(unloaded(recording, taken) for recording in setup.recordings)
    return setup.changed(recordings=recordings, additions=(*setup.additions, *additions))


def unloaded(recording: PreparedRecording, loads: dict[str, Ten]) -> PreparedRecording:
    taken = tuple(tuple(loads[load.name].tolist()) for load in recording.log.columns.loads)
    return recording.repaired(loads=taken) if taken else recording


def identified_loads(
    additions: Sequence[Addition], judged: Sequence[Parameter], holding: HeldLoads
) -> tuple[HeldLoad, ...]:
    """Loads of a fit by its additions and their judged parameters."""
    names = [(Path(where).name, {load.name for load in loads}) for where, loads in holding]
    return tuple(
        HeldLoad(
            name=addition.load.name,
            body=addition.body,
            logs=tuple(log for log, held in names if addition.load.name in held),
            parameters=addition.whole(fitted),
        )
        for addition, fitted in split_by_addition(additions, judged)
        if isinstance(addition, LoadColumns)
    )


def known_load(columns: LoadColumns, model: Model, where: str) -> Ten:
    """p_L of a load by a model, or as declared.

    Raises:
        RecordingError: neither gives it.
    """
    known = {load.name: load.p for load in model.identified.loads} if model.identified else {}
    name = columns.load.name
    if name not in known and columns.load.mass is None:
        raise RecordingError(
            f"holds load {name}, which is not one of the model's",
            where=where,
            cure="call it as the recording did that the model was identified from, or give "
            "its mass in the mapping (load: {mass: …, centre: […]})",
        )
    return known.get(name, columns.prior)


def as_identified(
    model: Model,
    log: Log,
    filtered: Callable[[Log, float | None], PreparedRecording] = with_filter,
) -> PreparedRecording:
    """A log filtered and corrected like the recordings that a model comes from, without the torques
    of its loads.

    Args:
        filtered: gives the log its filter, with a cut-off or its own.

    Raises:
        RecordingError: the log cannot be filtered, or neither it nor the model gives a load's
            parameters.
    """
    recording = model_filtered(model, log, filtered)
    loads, none = recording.log.columns.loads, np.zeros(10)
    columns = [LoadColumns(model.dynamics, load, model.prior_spread, none) for load in loads]
    where = str(recording.path)
    known = {column.load.name: known_load(column, model, where) for column in columns}
    return unloaded(recording, known)


def _rough(setup: Setup, columns: Sequence[LoadColumns]) -> list[Ten]:
    """p_L by the unconstrained minimum of (15): while lags, contacts and friction laws are unknown,
    consistency does not help."""
    if all(column.is_fixed for column in columns):
        return [column.prior for column in columns]
    additions = (*setup.additions, *columns)
    brief = [recording.brief for recording in setup.recordings]
    rows, prior = extended(setup.dynamics, additions), prior_parameters(setup.robot)
    information = gather_all(rows, brief, prior).information
    added = [(addition.parameters, addition.free) for addition in additions]
    reduction = build_reduction(setup.robot, information.columns, added)
    _, gradient, hessian = pose(information, reduction, setup.settings).evaluate(reduction.prior)
    p = reduction.A @ (reduction.prior - np.linalg.solve(hessian, gradient)) + reduction.p_0
    fitted = dict(split_by_addition(additions, p[len(setup.dynamics.layout.names) :]))
    return [c.prior if c.is_fixed else np.array(fitted[c]) for c in columns]


def undeclared_loads(setup: Setup, progress: Progress) -> Setup:
    """Stage for undeclared loads: the contest is held with detected loads and, unless all is
    explained, without them; the better explanation is kept."""
    if setup.settings.effects == "none":
        return setup
    first, detected = setup, dict(setup.detected)
    for k, study in enumerate(setup.studies):
        recording = setup.recordings[k]
        name = undeclared_name(recording)
        if study is None or name in setup.barred_effects:
            continue
        if held_load := _detected(setup, study, recording):
            study, load = held_load
            load = load.changed(name=name)
            held = holding(recording, load, 1.0 / study.fit.trace.low_pass.cutoff)
            setup, detected[load.name] = setup.with_recording(k, held), study
    if len(detected) > len(first.detected):
        setup = declared_loads(setup.changed(detected=detected), progress)
        setup = without_events(setup, progress)
        if short := _short(setup):
            barred = first.barred_effects | short
            return undeclared_loads(first.changed(barred_effects=barred), progress)
        setup = estimated_anew(setup.studied(), progress)
    if any(setup.disturbed):
        with_loads = setup
    elif len(detected) > len(first.detected):
        with_loads = contested(setup, progress)
    else:
        return setup
    needed = _kept_causes(with_loads)
    if not needed and _is_adequate(with_loads):
        return with_loads
    # Other causes may look like a load.
    without_loads = contested(first.changed(studies=()), progress)
    kept = _kept_causes(without_loads)
    explains = bool(kept) and _is_adequate(without_loads)
    needs_less = kept <= needed or not _is_adequate(with_loads)
    stands = explains and needs_less and not _leaves_more(without_loads, with_loads)
    return without_loads if stands else with_loads


def _short(setup: Setup) -> frozenset[str]:
    """Detected loads that are held, or not held, for such short times that exclusions fill most of
    these: no rows distinguish such a load from contacts."""
    return frozenset(
        load.name
        for recording in setup.recordings
        for load in recording.log.columns.loads
        if load.name in setup.detected and _is_filled(recording, load.spans or ())
    )


def _is_filled(recording: PreparedRecording, held: Sequence[tuple[float, float]]) -> bool:
    """Whether more than half of the time in these spans, or between them, is excluded."""
    excluded = [(span.first, span.last) for span in recording.repairs.left_out]
    excluded = joined_times(np.reshape(excluded, (-1, 2)))
    between = [(last, first) for (_, last), (first, _) in pairwise(held)]
    for first, last in (np.reshape(spans, (-1, 1, 2)).T for spans in (held, between)):
        both = np.minimum(last.T, excluded[:, 1]) - np.maximum(first.T, excluded[:, 0])
        if 2.0 * np.maximum(both, 0.0).sum() > np.sum(last - first):
            return True
    return False


def _kept_causes(setup: Setup) -> set[str]:
    return set(setup.outcome.kept) if setup.outcome else set()


def _leaves_more(other: Setup, setup: Setup) -> bool:
    """Whether another explanation leaves more residual beyond chance (95 %)."""
    rows = [
        (after.fit.rows, before.fit.rows)
        for after, before in zip(other.studies, setup.studies, strict=False)
        if after and before
    ]
    more = np.concatenate([np.zeros(0), *(np.log(a.scale / b.scale) for a, b in rows)])
    samples = sum(a.scale.size * a.samples for a, _ in rows)
    return samples > 0 and float(np.mean(more)) > NORMAL / float(np.sqrt(samples))


def _is_adequate(setup: Setup) -> bool:
    """Whether little torque is unexplained, and no unknown load comes and goes."""
    left = max((left_of_a_drive(study) for study in setup.studies if study), default=0.0)
    return left < ADEQUATE and not any(setup.disturbed)


def _detected(
    setup: Setup, study: Study, recording: PreparedRecording
) -> tuple[Study, Load] | None:
    """The undeclared load of a recording with its spans, and the study that detected it; None
    without one, or where the recording is too long."""
    if recording.log.columns.loads:
        return None
    if (bare := with_events(recording)).repairs != recording.repairs:
        # A load that is held for a short time looks like contacts.
        study = studied(setup.dynamics, bare) or study
    whole, cause = study, load_change(study)
    if cause is None:
        return None
    if effect_of(cause).held(cause, recording) is None:
        whole = studied(setup.dynamics, replace(bare, excerpt=None), seconds=_LONGEST)
        cause = whole and load_change(whole)
    load = cause and effect_of(cause).held(cause, recording)
    return (whole, load) if whole and load else None


def load_change(study: Study) -> Cause | None:
    """The cause of a study that is a load that comes and goes."""
    causes = causes_of(study.fit, study.account)
    return next((cause for cause in causes if cause.kind == LOAD_CHANGE), None)


def undeclared_name(recording: PreparedRecording) -> str:
    """One name a recording: two may hold different loads."""
    return f"undeclared-{recording.log.sha256[:8]}"


def holding(recording: PreparedRecording, load: Load, about: float = 0.0) -> PreparedRecording:
    """A recording with a load, without rows closer to its changes than their uncertainty [s]."""
    columns, kept = recording.log.columns, recording.repairs.left_out
    log = replace(recording.log, columns=replace(columns, loads=(*columns.loads, load)))
    changes = [time for span in load.spans or () for time in span]
    edges = (LeftSpan(time - about, time + about, LOAD_CHANGES) for time in changes)
    return replace(recording, log=log).repaired(left_out=(*kept, *edges))
