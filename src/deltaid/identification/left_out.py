"""What of a recording was excluded: masks, events and reversals, reason by reason."""

from collections.abc import Sequence

import numpy as np

from deltaid.identification.torque_error import TorqueError
from deltaid.model.sources import Event, LeftOut, Source, Span
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import WHY, Mask
from deltaid.recording.masks.runs import joined_times
from deltaid.recording.repairs import (
    CONTACT,
    JOLT,
    NO_REPAIRS,
    SPIKE,
    STOP,
    WHY_REPAIRED,
    LeftSpan,
    Repairs,
)

_WHY = {str(reason): why for reason, why in WHY.items()} | WHY_REPAIRED
_WHY_REVERSAL = "a joint turns round, and its friction with it, between two samples"
# Reasons that stand in the list of events.
_EVENTS = (CONTACT, STOP, SPIKE, JOLT)
# Spans that are listed of one reason.
_LISTED = 100


def left_out(
    log: Log, drives: Sequence[str], error: TorqueError, repairs: Repairs = NO_REPAIRS
) -> tuple[LeftOut, ...]:
    """What a comparison of torques excluded from a log, the reasons in the order of time."""
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
                spans=tuple(Span(start=a, end=b) for a, b in np.round(times, 6)[:_LISTED].tolist()),
                more=max(0, len(times) - _LISTED),
            )
        )
    turning = {drives[i]: share for i, share in enumerate(error.turning.tolist()) if share > 0}
    if turning:
        mean, turned = sum(turning.values()) / len(turning), tuple(turning)
        excluded.append(LeftOut(reason="reversal", why=_WHY_REVERSAL, drives=turned, share=mean))
    return tuple(excluded)


def events(repairs: Repairs, drives: Sequence[str]) -> tuple[Event, ...]:
    """All that acted on the robot apart from its drives; play in gears is no event."""
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
    """Of some drives; of all if none is given."""
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
