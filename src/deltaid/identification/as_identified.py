"""Recordings put right as those were that a model comes from."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.effects.windings import motors_of
from deltaid.identification.left_out import spans_left_out
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.record import Source
from deltaid.recording.gears import Gears
from deltaid.recording.log import Log
from deltaid.recording.recording import Recording, with_filter
from deltaid.recording.repairs import Repairs


def model_filtered(model: ModelLike, log: Log) -> Recording:
    """A log that a model is compared with, filtered and put right as the model's own recordings.

    Gains and lags are those of the drives, so any recording of them has the same: a lag that is
    estimated anew for each comparison would hide a wrong model. What was left out of a recording
    that the model comes from is left out again.

    Raises:
        RecordingError: the cut-off does not go with the log's rate, or the log is too short.
    """
    model = load(model)
    if model.identified is None:
        return with_filter(log)
    own = _sources(model, log)
    cutoff = next((s.cutoff_hz for s in own if s.cutoff_hz is not None), None)
    forced = model.identified.settings.cutoff is not None
    if any(one.kind == "velocity" for one in model.identified.corrections):
        log = replace(log, columns=replace(log.columns, velocity=(), acceleration=()))
    recording = with_filter(log, cutoff if forced or not log.has_derivatives else None)
    repairs = _repairs(model, log)
    return replace(recording, repairs=replace(repairs, gears=_gears(model, recording)))


def delays_of(model: Model, log: Log | None = None) -> Float[np.ndarray, " drives"]:
    """By how much the torques of each drive come late [s].

    Args:
        log: those of this very recording, if the model comes from it; else their mean.
    """
    none = (0.0,) * len(model.robot.drives)
    known = model.identified.sources if model.identified else ()
    own = known if log is None else _sources(model, log)
    return np.mean([one.delay or none for one in own] or [none], axis=0)


def _sources(model: Model, log: Log) -> tuple[Source, ...]:
    """The very recording if the model comes from it, else all that it comes from."""
    sources = model.identified.sources if model.identified else ()
    return tuple(one for one in sources if one.sha256 == log.sha256) or sources


def _repairs(model: Model, log: Log) -> Repairs:
    """What was found wrong with the model's drives, and is with any recording of them."""
    gains, delay = model.gains, tuple(delays_of(model, log).tolist())
    same = [one for one in _sources(model, log) if one.sha256 == log.sha256]
    return Repairs(
        gain=tuple(gains.tolist()) if np.any(gains != 1.0) else (),
        delay=delay if any(delay) else (),
        left_out=spans_left_out(same[0], model.robot.drives) if same else (),
    )


def _gears(model: Model, recording: Recording) -> Gears | None:
    """Those of the model that wind up, for a recording that is filtered."""
    corrections = model.identified.corrections if model.identified else ()
    found = {one.subject: one.value for one in corrections if one.kind == "compliance"}
    if not found or recording.low_pass is None:
        return None
    motors = motors_of(model.robot, model.p, recording.low_pass.cutoff, recording.log.rate)
    return replace(motors, compliance=tuple(found.get(d) or 0.0 for d in model.robot.drives))
