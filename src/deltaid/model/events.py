"""What acted on a robot beside its drives in a recording, as a model file and JSON have it."""

from deltaid.robot.part import Part


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
