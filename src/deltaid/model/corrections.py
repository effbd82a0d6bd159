"""Corrections of an identification for the model file: corrected faults, effects and sensors,
inseparable causes, and source logs with their excluded rows and events."""

from typing import Annotated, Literal

from pydantic import Field

from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import listed
from deltaid.robot.part import Part

Share = Annotated[float, Field(ge=0, le=1)]


class TimeSpan(Part):
    """First and last time stamp of excluded rows [s]."""

    start: float
    end: float


class LeftOut(Part):
    """Rows of a recording that were excluded for one reason, for the same drives.

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
    """A contact, a stop or a torque spike, excluded from a recording.

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
    """A log of a model, and its filter."""

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
    drift: tuple[tuple[float, float], ...] = Field(
        default=(),
        description="how torque constants drift along it, by a s + b s² at the share s of its "
        "time; a and b of each drive, empty where they do not",
    )
    events: tuple[Event, ...] = Field(
        default=(),
        description="what acted on the robot beside its drives; missing in earlier files",
    )


Kind = Literal[
    "velocity",
    "lag",
    "filter",
    "hold",
    "clock",
    "load",
    "contact",
    "backlash",
    "friction",
    "temperature",
    "gain",
    "sensor",
    "compliance",
    "zero",
    "gear-ratio",
    "length",
    "tilt",
    "torque-constant",
    "torque-drift",
    "ripple",
    "drive-spring",
    "platform-force",
    "structure",
    "prior",
    "cutoff",
]


# Each kind in words.
NAMES: dict[Kind, str] = {
    "velocity": "recorded velocities excluded",
    "lag": "lag between torques and positions",
    "filter": "filter of torques",
    "hold": "torques held between updates",
    "clock": "clocks that differ",
    "load": "held load",
    "contact": "contacts",
    "backlash": "play in gears",
    "friction": "friction law",
    "temperature": "friction that warms up",
    "gain": "torque constant",
    "sensor": "sensor",
    "compliance": "gears that wind up",
    "zero": "zero of a drive",
    "gear-ratio": "gear ratio",
    "length": "length",
    "tilt": "tilt of the base",
    "torque-constant": "torque constant that falls with current",
    "torque-drift": "torque constant that drifts with time",
    "ripple": "ripple",
    "drive-spring": "springs at drives",
    "platform-force": "force at the platform",
    "structure": "shape of bodies",
    "prior": "prior made wider",
    "cutoff": "cut-off of the filter",
}


def cause_in_words(name: str) -> str:
    """A cause by the name of an effect, such as `tilt` or 'ripple of drive1, 34'."""
    words: dict[str, str] = {str(kind): said for kind, said in NAMES.items()}
    further = {"platform-spring": "spring at the platform", "platform-drag": "drag at the platform"}
    return (words | further).get(name, name)


class Correction(Part):
    """One correction, on the evidence of the recordings.

    Attributes:
        kind: what sort of thing it is.
        subject: drive, joint or body; empty for all of them.
        log: the recording that it was done to; empty for the model.
        value: its size, if it has one, with a 95 % interval where that is known.
        unit: of these.
        text: a sentence on what was done and why.
    """

    kind: Kind
    subject: str = ""
    log: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    text: Annotated[str, Field(min_length=1)]


class FittedEffect(Part):
    """A permanent torque on the drives, such as by a hose.

    Attributes:
        name: of the effect, such as 'platform-force'.
        values: of its coefficients.
        drives: that it acts on; empty where it acts on the platform.
        orders: of ripples, one a drive [1/rad or 1/m].
        fastest: speed of the platform that a drag is smoothed with [m/s].
    """

    name: str
    values: tuple[float, ...]
    drives: tuple[str, ...] = ()
    orders: tuple[float, ...] = ()
    fastest: float = 0.0


class Inseparable(Part):
    """Two causes of the same torques that the recordings do not separate.

    Attributes:
        causes: the one that the model has, and the other.
        subjects: drives that they are of; empty for the robot.
        is_counted: whether intervals count both; else they take the second as described.
    """

    causes: tuple[str, str]
    subjects: tuple[str, ...] = ()
    is_counted: bool = True

    @property
    def text(self) -> str:
        """The pair as a sentence."""
        whose = f" ({listed(list(self.subjects))})" if self.subjects else ""
        kept, other = self.causes
        counted = "intervals count both" if self.is_counted else f"intervals rest on {other}"
        return f"The recordings do not separate {kept} from {other}{whose}; {counted}."


NotNegative = Annotated[float, Field(ge=0)]


class FittedChannel(Part):
    """One channel of a sensor.

    `left` is the root mean square of what the fit leaves of it after the low-pass, `largest` the
    largest magnitude there; `stated` is the noise that the description gives, before the low-pass.
    """

    name: str
    unit: str
    stated: NotNegative
    left: NotNegative
    largest: NotNegative


class FittedSensor(Part):
    """A sensor: its channels, and its own unknowns with intervals."""

    name: str
    channels: tuple[FittedChannel, ...]
    parameters: tuple[Parameter, ...] = ()
