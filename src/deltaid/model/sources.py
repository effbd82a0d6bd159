"""A log that a model comes from: what of it was excluded, and what acted on the robot in it."""

from typing import Annotated

from pydantic import Field

from deltaid.robot.part import Part

Share = Annotated[float, Field(ge=0, le=1)]


class TimeSpan(Part):
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
    spans: tuple[TimeSpan, ...] = ()
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


class Source(Part):
    """A log that a model comes from, and how it was filtered."""

    log: str
    sha256: str
    samples: int
    rate_hz: float
    cutoff_hz: float | None = None
    motion_cutoff_hz: float | None = Field(
        default=None, description="of the positions; missing in earlier files"
    )
    used_samples: int
    left_out: tuple[LeftOut, ...] = Field(
        default=(), description="what was excluded; missing in earlier files"
    )
    delay: tuple[float, ...] = Field(
        default=(), description="by how much torques of each drive are late [s]; empty: none"
    )
    filters: tuple[float, ...] = Field(
        default=(), description="time constants of drives' filters among it [s]; empty: none"
    )
    growth: tuple[float, float, float] | None = Field(
        default=None,
        description="rate at which the delay grows, the time at which it is the one above, and how "
        "far other times are from there at most [s]; missing where clocks agree",
    )
    events: tuple[Event, ...] = Field(
        default=(),
        description="what acted on the robot beside its drives; missing in earlier files",
    )
