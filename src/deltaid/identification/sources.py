"""Recordings in the file of a model, with their corrections and exclusions by reason; and other
recordings corrected as those were that a model comes from."""

from collections.abc import Callable, Sequence
from dataclasses import astuple, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.effects.all import as_fitted
from deltaid.effects.along_motion import FittedTorques
from deltaid.effects.windings import motors_of
from deltaid.errors import DescriptionError, quoted
from deltaid.identification.torque_error import TorqueError
from deltaid.model.corrections import Event, FittedEffect, LeftOut, Source, TimeSpan
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.verdict import listed
from deltaid.recording.delay import LagGrowth
from deltaid.recording.hold import holds
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import WHY, Mask, joined_times
from deltaid.recording.recording import PreparedRecording, with_filter
from deltaid.recording.repairs import (
    CHANGE,
    CONTACT,
    JOLT,
    NO_REPAIRS,
    SPIKE,
    STOP,
    WHY_REPAIRED,
    LeftSpan,
    Repairs,
)
from deltaid.recording.row_sample import REPEATED, from_text, in_text, shared_rows

_WHY = {str(reason): why for reason, why in WHY.items()} | WHY_REPAIRED
_WHY_REVERSAL = "a joint turns round, and its friction with it, between two samples"
# Reasons that a model file lists as events.
_EVENTS = (CONTACT, STOP, SPIKE, CHANGE, JOLT)
# Most spans that a model file lists of one reason.
_LISTED = 100


def source(
    recording: PreparedRecording, used: int, error: TorqueError, drives: tuple[str, ...]
) -> Source:
    """The record of a recording that a model was compared with; the fit `used` so many samples."""
    log, repairs = recording.log, recording.repairs
    return Source(
        log=log.path.name,
        sha256=log.sha256,
        samples=log.samples,
        rate_hz=log.rate,
        cutoff_hz=recording.cutoff,
        motion_cutoff_hz=recording.motion_cutoff,
        used_samples=used,
        rows=in_text(log.sample),
        left_out=left_out(log, drives, error, repairs),
        events=events(repairs, drives),
        delay=repairs.lag,
        filters=repairs.constants,
        growth=repairs.growth and astuple(repairs.growth),
        drift=repairs.drift.coefficients if repairs.drift else (),
    )


def repeated(sources: Sequence[Source], sha256: str, rows: str) -> Source | None:
    """The source that a recording with this checksum and these numbers of rows is a copy or an
    excerpt of, or the other way round; None if it has other rows."""
    sample = from_text(rows)
    for source in sources:
        if source.sha256 == sha256 or shared_rows(from_text(source.rows), sample) >= REPEATED:
            return source
    return None


def model_filtered(
    model: ModelLike,
    log: Log,
    filtered: Callable[[Log, float | None], PreparedRecording] = with_filter,
) -> PreparedRecording:
    """A log, filtered and corrected like the recordings that a model comes from.

    Gains and lags are properties of the drives, so all recordings have the same: estimating a lag
    for each comparison would hide a wrong model. From a recording that the model comes from, the
    same rows are excluded again.

    Args:
        filtered: gives the log its filter, with a cut-off or its own.

    Raises:
        RecordingError: the cut-off is too high for the log's rate, or the log is too short.
    """
    model = load(model)
    identified = model.identified
    if identified is None:
        return filtered(log, None)
    sources, corrections = _sources(model, log), identified.corrections
    cutoff = next((s.cutoff_hz for s in sources if s.cutoff_hz is not None), None)
    forced = identified.settings.cutoff is not None
    kinds = {correction.kind for correction in corrections}
    if "velocity" in kinds:
        log = replace(log, columns=log.columns.without_rates)
    recording = filtered(log, cutoff if forced or not log.has_derivatives else None)
    gears, compliance = None, {c.subject: c.value for c in corrections if c.kind == "compliance"}
    if compliance and recording.low_pass is not None:
        soft = [compliance.get(drive) or 0.0 for drive in model.robot.drives]
        cutoff, rate = recording.low_pass.cutoff, recording.log.rate
        gears = motors_of(model.robot, model.p, cutoff, rate, soft)
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
        growth=LagGrowth(*same[0].growth) if same and same[0].growth else None,
        drift=recording.drifting(same[0].drift) if same and same[0].drift else None,
        left_out=spans_left_out(same[0], model.robot.drives) if same else (),
        gears=gears,
        readings=identified.readings,
        pulls=tuple(_fitted(model, effect) for effect in identified.effects),
    )
    return replace(recording, repairs=repairs)


def _fitted(model: Model, effect: FittedEffect) -> FittedTorques:
    try:
        return as_fitted(model.dynamics, effect)
    except (StopIteration, ValueError, IndexError):
        raise DescriptionError(
            f"has the effect '{quoted(effect.name)}' of {listed(effect.drives) or 'the platform'}, "
            "which this deltaid does not know",
            where=model.source,
            cure="take back what `deltaid identify` wrote, or identify the model again",
        ) from None


def delays_of(model: Model, log: Log | None = None) -> Float[np.ndarray, " drives"]:
    """The lag of each drive's torque [s], as a mean over the recordings that the model comes from,
    or in a log that is one of these."""
    return _mean_of(_sources(model, log), "delay", model)


def _mean_of(
    sources: Sequence[Source], name: Literal["delay", "filters"], model: Model
) -> Float[np.ndarray, " drives"]:
    """Mean over sources of a number of each drive; zero counts where a source has none."""
    none = (0.0,) * len(model.robot.drives)
    return np.mean([getattr(source, name) or none for source in sources] or [none], axis=0)


def _sources(model: Model, log: Log | None) -> tuple[Source, ...]:
    """The log itself if the model comes from it, else all recordings that it comes from."""
    sources = model.identified.sources if model.identified else ()
    same = tuple(source for source in sources if log is not None and source.sha256 == log.sha256)
    return same or sources


def left_out(
    log: Log, drives: Sequence[str], error: TorqueError, repairs: Repairs = NO_REPAIRS
) -> tuple[LeftOut, ...]:
    """Exclusions from a log in a comparison of torques, by reason and drives."""
    groups: dict[tuple[str, tuple[int, ...]], list[Mask | LeftSpan]] = {}
    for span in (*log.masks, *repairs.left_out):
        groups.setdefault((span.reason, span.drives), []).append(span)
    excluded = list[LeftOut]()
    for (reason, numbers), spans in groups.items():
        masks = [span for span in spans if isinstance(span, Mask)]
        times = np.array([(mask.start, mask.end) for mask in masks])
        rows = float(sum(mask.last - mask.first + 1 for mask in masks))
        if not masks:
            times = joined_times(np.array([(span.first, span.last) for span in spans]))
            rows = float(np.diff(times).sum()) * log.rate
        excluded.append(
            LeftOut(
                reason=reason,
                why=_WHY[reason],
                drives=_names(numbers, drives),
                share=min(1.0, rows / log.samples),
                spans=tuple(
                    TimeSpan(start=start, end=end)
                    for start, end in np.round(times, 6)[:_LISTED].tolist()
                ),
                more=max(0, len(times) - _LISTED),
            )
        )
    turning = {drives[i]: share for i, share in enumerate(error.turning.tolist()) if share > 0}
    if turning:
        mean, turned = sum(turning.values()) / len(turning), tuple(turning)
        excluded.append(LeftOut(reason="reversal", why=_WHY_REVERSAL, drives=turned, share=mean))
    return tuple(excluded)


def events(repairs: Repairs, drives: Sequence[str]) -> tuple[Event, ...]:
    """Excluded events, such as contacts; play in gears is none."""
    return tuple(
        Event(
            reason=span.reason,
            start=round(span.first, 6),
            end=round(span.last, 6),
            drives=_names(span.drives, drives),
            time=span.push and round(span.push.time, 6),
            place=span.push and span.push.place,
            force=span.push and span.push.force,
            moment=span.push and span.push.moment,
        )
        for span in repairs.left_out
        if span.reason in _EVENTS
    )


def _names(numbers: Sequence[int], drives: Sequence[str]) -> tuple[str, ...]:
    """Names of drives by number; all of them without numbers."""
    return tuple(drives[i] for i in numbers or range(len(drives)))


def spans_left_out(source: Source, drives: Sequence[str]) -> tuple[LeftSpan, ...]:
    """Events and exclusions of a recording in a model file, as spans to exclude again."""
    excluded = [(event.reason, event.drives, event.start, event.end) for event in source.events]
    excluded += [
        (entry.reason, entry.drives, span.start, span.end)
        for entry in source.left_out
        if entry.reason in WHY_REPAIRED and entry.reason not in _EVENTS
        for span in entry.spans
    ]
    return tuple(
        LeftSpan(start, end, reason, tuple(drives.index(drive) for drive in names))
        for reason, names, start, end in excluded
    )
