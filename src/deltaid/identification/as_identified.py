"""Recordings corrected as those were that a model comes from."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.effects.at_platform import as_fitted
from deltaid.effects.windings import motors_of
from deltaid.identification.left_out import spans_left_out
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.sources import Source
from deltaid.recording.delay import Growth
from deltaid.recording.hold import holds
from deltaid.recording.log import Log
from deltaid.recording.recording import Recording, with_filter
from deltaid.recording.repairs import Repairs


def model_filtered(model: ModelLike, log: Log) -> Recording:
    """A log that a model is compared with, filtered and corrected as the model's own recordings.

    Gains and lags are those of the drives, so any recording of them has the same: a lag that is
    estimated anew for each comparison would hide a wrong model. What was excluded from a
    recording that the model comes from is excluded again.

    Raises:
        RecordingError: the cut-off does not go with the log's rate, or the log is too short.
    """
    model = load(model)
    identified = model.identified
    if identified is None:
        return with_filter(log)
    sources, corrections = _sources(model, log), identified.corrections
    cutoff = next((s.cutoff_hz for s in sources if s.cutoff_hz is not None), None)
    forced = identified.settings.cutoff is not None
    kinds = {correction.kind for correction in corrections}
    if "velocity" in kinds:
        log = replace(log, columns=replace(log.columns, velocity=(), acceleration=()))
    recording = with_filter(log, cutoff if forced or not log.has_derivatives else None)
    gears, compliance = None, {c.subject: c.value for c in corrections if c.kind == "compliance"}
    if compliance and recording.low_pass is not None:
        motors = motors_of(model.robot, model.p, recording.low_pass.cutoff, recording.log.rate)
        values = (compliance.get(drive) or 0.0 for drive in model.robot.drives)
        gears = replace(motors, compliance=tuple(values))
    filters = _mean_of(sources, "filters", model)
    dead, hold = tuple((delays_of(model, log) - filters).tolist()), ()
    if "hold" in kinds:
        hold = holds(log.segments(recording.motion_cutoff), log.columns, log.rate)
    same = [source for source in sources if source.sha256 == log.sha256]
    repairs = Repairs(
        gain=tuple(model.gains.tolist()) if np.any(model.gains != 1.0) else (),
        hold=hold if any(hold) else (),
        delay=dead if any(dead) else (),
        constants=tuple(filters.tolist()) if np.any(filters) else (),
        growth=Growth(*same[0].growth) if same and same[0].growth else None,
        left_out=spans_left_out(same[0], model.robot.drives) if same else (),
        gears=gears,
        readings=identified.readings,
        pulls=tuple(as_fitted(model.dynamics, effect) for effect in identified.effects),
    )
    return replace(recording, repairs=repairs)


def delays_of(model: Model, log: Log | None = None) -> Float[np.ndarray, " drives"]:
    """By how much the torques of each drive come late [s]; in the mean over the recordings that the
    model comes from, or in a log that is one of these."""
    return _mean_of(_sources(model, log), "delay", model)


def _mean_of(
    sources: Sequence[Source], name: Literal["delay", "filters"], model: Model
) -> Float[np.ndarray, " drives"]:
    """Of a number of each drive over sources; zero where one has none."""
    none = (0.0,) * len(model.robot.drives)
    return np.mean([getattr(source, name) or none for source in sources] or [none], axis=0)


def _sources(model: Model, log: Log | None) -> tuple[Source, ...]:
    """The very recording if the model comes from it, else all that it comes from."""
    sources = model.identified.sources if model.identified else ()
    same = tuple(source for source in sources if log is not None and source.sha256 == log.sha256)
    return same or sources
