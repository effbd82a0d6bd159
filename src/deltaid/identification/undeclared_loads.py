"""Loads that come and go and that no mapping declares: identified as if one did.

A study says when, by the mass that the torques have more of. What the robot is without the load is
then known from all of the recording; that it was there is a verdict.
"""

from dataclasses import replace

from deltaid.effects.all import effect_of
from deltaid.effects.effect import Cause, causes_of
from deltaid.identification.compliance import gears_turned_back
from deltaid.identification.events import with_events, without_events
from deltaid.identification.gains import gains
from deltaid.identification.lag_stage import lags_corrected
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Progress, Setup, Stage
from deltaid.identification.study import LOAD_CHANGE, Study, studied
from deltaid.recording.carried import Load
from deltaid.recording.masks.masks import LOAD_CHANGES
from deltaid.recording.recording import Recording
from deltaid.recording.repairs import LeftSpan

# The longest recording whose rows are searched for a load's times [s]: they are held in memory.
_LONGEST = 600.0
# What is known of recordings only without what they carry.
_ANEW: tuple[Stage, ...] = (gains, lags_corrected, gears_turned_back)


def undeclared_loads(setup: Setup, progress: Progress) -> Setup:
    """Loads that the residual of recordings has when gears have been turned back; a stage."""
    if setup.settings.effects == "none":
        return setup
    detected = dict(setup.detected)
    for k, study in enumerate(setup.studies):
        found = study and _detected(setup, study, setup.recordings[k])
        if found:
            study, load = found
            load = load.changed(name=_name(setup.recordings[k]))
            holding = _holding(setup.recordings[k], load, 1.0 / study.fit.trace.low_pass.cutoff)
            setup, detected[load.name] = setup.with_recording(k, holding), study
    if len(detected) == len(setup.detected):
        return setup
    setup = declared_loads(setup.changed(detected=detected), progress)
    setup = without_events(setup, progress).studied()
    for stage in _ANEW:
        setup = stage(setup, progress)
    return setup


def _detected(setup: Setup, study: Study, recording: Recording) -> tuple[Study, Load] | None:
    """What a recording holds and when, and the study of all of it that says so; None where no load
    is detected, or where the recording is too long."""
    if recording.log.columns.loads:
        return None
    if (bare := with_events(recording)).repairs != recording.repairs:
        # What is held for a short time looks like contacts.
        study = studied(setup.dynamics, bare) or study
    cause = load_change(study)
    if cause is None:
        return None
    whole: Study | None = study
    if effect_of(cause).held(cause, recording) is None:
        whole = studied(setup.dynamics, replace(bare, excerpt=None), seconds=_LONGEST)
        cause = whole and load_change(whole)
    load = cause and effect_of(cause).held(cause, recording)
    return (whole, load) if whole and load else None


def load_change(study: Study) -> Cause | None:
    """A load that comes and goes, as a study detected it."""
    causes = causes_of(study.fit, study.account)
    return next((cause for cause in causes if cause.kind == LOAD_CHANGE), None)


def _name(recording: Recording) -> str:
    """That no other recording's load has: whether two hold the same is not known."""
    return f"undeclared-{recording.log.sha256[:8]}"


def _holding(recording: Recording, load: Load, about: float) -> Recording:
    """A recording with a load, without what is closer to its changes than they are known [s]."""
    columns, repairs = recording.log.columns, recording.repairs
    log = replace(recording.log, columns=replace(columns, loads=(*columns.loads, load)))
    changes = [time for span in load.spans or () for time in span]
    edges = (LeftSpan(time - about, time + about, LOAD_CHANGES) for time in changes)
    left_out = (*repairs.left_out, *edges)
    return replace(recording, log=log, repairs=replace(repairs, left_out=left_out))
