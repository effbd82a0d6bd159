"""What of a recording was left out: masks and reversals, reason by reason."""

from collections.abc import Sequence

from deltaid.identification.torque_error import TorqueError
from deltaid.model.left_out import LeftOut, Span
from deltaid.recording.log import Log
from deltaid.recording.masks.masks import WHY, Mask, Reason

REVERSAL, WHY_REVERSAL = (
    "reversal",
    "a joint turns round, and its friction with it, between two samples",
)
# Spans that are listed of one reason.
_LISTED = 100


def left_out(log: Log, drives: Sequence[str], error: TorqueError) -> tuple[LeftOut, ...]:
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
    turning = {drives[i]: share for i, share in enumerate(error.turning.tolist()) if share > 0}
    if turning:
        mean = sum(turning.values()) / len(turning)
        every = tuple(turning)
        found.append(LeftOut(reason=REVERSAL, why=WHY_REVERSAL, drives=every, share=mean))
    return tuple(found)


def _span(mask: Mask) -> Span:
    return Span(start=round(mask.start, 6), end=round(mask.end, 6))
