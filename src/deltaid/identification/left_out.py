"""What of a recording was left out: masks, events and reversals, reason by reason."""

from collections.abc import Sequence

import numpy as np

from deltaid.identification.torque_error import TorqueError
from deltaid.model.events import Event
from deltaid.model.left_out import LeftOut, Span
from deltaid.model.record import Source
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import WHY, Mask, Reason
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

REVERSAL, WHY_REVERSAL = (
    "reversal",
    "a joint turns round, and its friction with it, between two samples",
)
# Reasons that stand in the list of events.
EVENTS = (CONTACT, STOP, SPIKE, JOLT)
# Spans that are listed of one reason.
_LISTED = 100


def left_out(
    log: Log,
    drives: Sequence[str],
    error: TorqueError,
    repairs: Repairs = NO_REPAIRS,
) -> tuple[LeftOut, ...]:
    """What a comparison of torques has left out of a log, the reasons in the order of time."""
    groups: dict[tuple[Reason, tuple[int, ...]], list[Mask]] = {}
    for mask in log.masks:
        groups.setdefault((mask.reason, mask.drives), []).append(mask)
    found = [
        LeftOut(
            reason=reason,
            why=WHY[reason],
            drives=tuple(drives[i] for i in which),
            share=sum(mask.last - mask.first + 1 for mask in masks) / log.samples,
            spans=tuple(_span(mask) for mask in masks[:_LISTED]),
            more=max(0, len(masks) - _LISTED),
        )
        for (reason, which), masks in groups.items()
    ]
    found += _repaired(log, drives, repairs)
    turning = {drives[i]: share for i, share in enumerate(error.turning.tolist()) if share > 0}
    if turning:
        mean = sum(turning.values()) / len(turning)
        every = tuple(turning)
        found.append(LeftOut(reason=REVERSAL, why=WHY_REVERSAL, drives=every, share=mean))
    return tuple(found)


def _repaired(log: Log, drives: Sequence[str], repairs: Repairs) -> list[LeftOut]:
    """What is left out because of what happened there."""
    groups: dict[tuple[str, tuple[int, ...]], list[LeftSpan]] = {}
    for span in repairs.left_out:
        groups.setdefault((span.reason, span.drives), []).append(span)
    return [
        LeftOut(
            reason=reason,
            why=WHY_REPAIRED[reason],
            drives=tuple(drives[i] for i in which or range(len(drives))),
            share=min(1.0, float(np.diff(times).sum()) * log.rate / log.samples),
            spans=tuple(Span(start=a, end=b) for a, b in np.round(times, 6)[:_LISTED].tolist()),
            more=max(0, len(times) - _LISTED),
        )
        for (reason, which), spans in groups.items()
        for times in (joined_times(np.array([(span.first, span.last) for span in spans])),)
    ]


def events(repairs: Repairs, drives: Sequence[str]) -> tuple[Event, ...]:
    """What acted on the robot beside its drives, all of it; play in gears is none of that."""
    return tuple(
        Event(
            reason=span.reason,
            start=round(span.first, 6),
            end=round(span.last, 6),
            drives=tuple(drives[i] for i in span.drives or range(len(drives))),
            time=span.push and round(span.push.time, 6),
            place=span.push and span.push.place,
            force=span.push and span.push.force,
            moment=span.push and span.push.moment,
        )
        for span in repairs.left_out
        if span.reason in EVENTS
    )


def spans_left_out(source: Source, drives: Sequence[str]) -> tuple[LeftSpan, ...]:
    """What a model file says of what happened in a recording, as stretches to leave out again."""
    known = [(one.reason, one.drives, one.start, one.end) for one in source.events]
    known += [
        (one.reason, one.drives, span.start, span.end)
        for one in source.left_out
        if one.reason in WHY_REPAIRED and one.reason not in EVENTS
        for span in one.spans
    ]
    return tuple(
        LeftSpan(start, end, reason, tuple(drives.index(one) for one in which))
        for reason, which, start, end in known
    )


def _span(mask: Mask) -> Span:
    return Span(start=round(mask.start, 6), end=round(mask.end, 6))
