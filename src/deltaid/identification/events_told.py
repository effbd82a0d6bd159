"""What acted on a robot beside its drives, in words."""

from collections.abc import Sequence

import numpy as np

from deltaid.model.corrections import Correction
from deltaid.recording.recording import Recording
from deltaid.recording.repairs import BACKLASH, CONTACT, JOLT, SPIKE, STOP, LeftSpan

# What events are left out for.
REASONS = (CONTACT, STOP, SPIKE, JOLT, BACKLASH)


def events_told(
    spans: Sequence[LeftSpan], recording: Recording, drives: Sequence[str]
) -> list[Correction]:
    """One correction for each kind of event of a recording."""
    found = []
    for reason in REASONS:
        own = [span for span in spans if span.reason == reason]
        if not own:
            continue
        total = sum(span.last - span.first for span in own)
        found.append(
            Correction(
                kind="contact",
                subject=reason,
                log=recording.path.name,
                value=total,
                unit="s",
                text=_TEXT[reason](own),
            )
        )
    return found


def _largest(spans: Sequence[LeftSpan]) -> str:
    """The largest force among some, in words."""
    forces = [np.linalg.norm(span.push.force) for span in spans if span.push]
    k = int(np.argmax(forces))
    push = [span.push for span in spans if span.push][k]
    return f"the largest {forces[k]:.3g} N at {push.time:.3f} s"


_TEXT = {
    CONTACT: lambda own: (
        f"{_times(own)} something pushed the platform, {_largest(own)}: torques stand out from "
        "all that the motion asks for"
    ),
    STOP: lambda own: (
        f"{_times(own)} the robot was stopped by more than its drives, {_largest(own)}"
    ),
    SPIKE: lambda own: (
        f"{_times(own)} the torque of one drive jumps for a sample or three, as errors of a "
        "fieldbus do"
    ),
    JOLT: lambda own: (
        f"{_times(own)} torque and motion change faster than the low-pass of the positions follows"
    ),
    BACKLASH: lambda own: (
        f"{_times(own)} positions jump where a gear's torque changes its sign: play in the gears"
    ),
}


def _times(own: Sequence[LeftSpan]) -> str:
    return "once" if len(own) == 1 else f"{len(own)} times"
