"""What of a recording was left out, as a model file and JSON have it.

What acted on a robot beside its drives in a recording, as a model file and JSON have it.
"""

from typing import Annotated

from pydantic import Field

from deltaid.robot.part import Part

Share = Annotated[float, Field(ge=0, le=1)]


class Span(Part):
    """When rows were left out, by their first and their last time stamp [s]."""

    start: float
    end: float


class LeftOut(Part):
    """Rows that were left out of a recording for one reason, alike for some drives.

    `share` is that of the recording's rows. Of many spans the first ones are listed, and `more`
    says how many there are beside them. Reversals have no spans, and a share in the mean over their
    drives.
    """

    reason: str
    why: str
    drives: tuple[str, ...]
    share: Share
    spans: tuple[Span, ...] = ()
    more: Annotated[int, Field(ge=0)] = 0


class Event(Part):
    """A contact, a stop or a torque spike, which was left out of a recording.

    Times in s. `place` is that of the platform point in the world [m] and `force` what acted on it
    there [N], both at `time`, where it was largest; `moment` is that about the axis that the tool
    turns about [N m]. A spike of a torque channel has none of these.
    """

    reason: str
    start: float
    end: float
    drives: tuple[str, ...]
    time: float | None = None
    place: tuple[float, float, float] | None = None
    force: tuple[float, float, float] | None = None
    moment: float | None = None
