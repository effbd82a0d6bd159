"""What acted on a robot beside its drives, in words."""

from collections.abc import Sequence

import numpy as np

from deltaid.model.corrections import Correction
from deltaid.recording.masks.runs import joined_times
from deltaid.recording.recording import Recording
from deltaid.recording.repairs import BACKLASH, CONTACT, JOLT, SPIKE, STOP, LeftSpan

# What events are left out for.
REASONS = (CONTACT, STOP, SPIKE, JOLT, BACKLASH)


def events_told(
    spans: Sequence[LeftSpan], recording: Recording, drives: Sequence[str]
) -> list[Correction]:
    """One correction for each kind of event of a recording, and for each gear with play."""
    found, name = list[Correction](), recording.path.name
    for reason in (*_TEXT, BACKLASH):
        for gear in sorted({s.gear for s in spans if s.reason == reason}, key=lambda i: i or 0):
            own = [one for one in spans if one.reason == reason and one.gear == gear]
            kind, subject = ("contact", reason) if gear is None else ("backlash", drives[gear])
            times = joined_times(np.array([(one.first, one.last) for one in own]))
            text = _TEXT[reason](own) if gear is None else _play(len(times))
            time = float(np.diff(times).sum())
            found.append(
                Correction(kind=kind, subject=subject, log=name, value=time, unit="s", text=text)
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
}


def _play(times: int) -> str:
    return (
        "its gear has play: torques do not follow from the motion where its torque changes its "
        f"sign, {times} times. All drives' are left out there"
    )


def _times(own: Sequence[LeftSpan]) -> str:
    return "once" if len(own) == 1 else f"{len(own)} times"
