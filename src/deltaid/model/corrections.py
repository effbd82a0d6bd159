"""Records of corrections in a model file: faults, effects and sensors that were corrected, causes
that cannot be separated, and source logs with their excluded rows and events."""

from typing import Annotated, Literal

from pydantic import Field

from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import listed
from deltaid.robot.part import Part

Share = Annotated[float, Field(ge=0, le=1)]
Delay = Annotated[float, Field(ge=-1, le=1)]
RowNumbers = Annotated[str, Field(pattern=r"^([0-9a-f]{16})*$")]


class TimeSpan(Part):
    """First and last time stamp of a stretch of excluded rows [s]."""

    start: float
    end: float


class LeftOut(Part):
    """Rows of a recording that were excluded for one reason, for the same drives.

    `share` is a share of the recording's rows. If there are many spans, only the first are listed
    and `more` counts the others. Reversals have no spans; their share is the mean over their
    drives.
    """

    reason: str
    why: str
    drives: tuple[str, ...]
    share: Share
    spans: tuple[TimeSpan, ...] = ()
    more: Annotated[int, Field(ge=0)] = 0


class Event(Part):
    """A contact, a stop or a torque spike that was excluded from a recording.

    Times are in s. `place` is the position of the platform point in the world [m], `force` the
    force on it [N], both at `time`, when the force was largest; `moment` is the moment about the
    axis of the tool's turn [N m]. A spike of a torque channel has none of these.
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
    """A log that a model was identified from, and its filter."""

    log: str
    sha256: str
    samples: int
    rate_hz: float
    cutoff_hz: float | None = None
    motion_cutoff_hz: float | None = Field(
        default=None, description="cut-off of the positions' filter; missing in earlier files"
    )
    used_samples: int
    rows: RowNumbers = Field(
        default="",
        description="numbers of some rows, by which copies and excerpts are recognised; missing in "
        "earlier files",
    )
    left_out: tuple[LeftOut, ...] = Field(
        default=(), description="excluded rows; missing in earlier files"
    )
    delay: tuple[Delay, ...] = Field(
        default=(), description="lag of each drive's torque [s]; empty without lags"
    )
    filters: tuple[float, ...] = Field(
        default=(),
        description="time constants of the drives' filters, part of the lag [s]; empty without",
    )
    growth: tuple[float, float, float] | None = Field(
        default=None,
        description="rate at which the delay grows, time at which it has the value above, and "
        "largest distance of other times from that [s]; missing if the clocks agree",
    )
    drift: tuple[tuple[float, float] | tuple[float, float, float], ...] = Field(
        default=(),
        description="drift of torque constants since the beginning of the first recording, "
        "a s + b s² + c at the share s of this one's time: a, b and c of each drive, c missing in "
        "earlier files; empty without drift",
    )
    events: tuple[Event, ...] = Field(
        default=(),
        description="forces on the robot besides those of its drives; missing in earlier files",
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
    "mounting",
    "tilt",
    "torque-constant",
    "torque-drift",
    "ripple",
    "drive-spring",
    "presliding",
    "platform-force",
    "platform-spring",
    "platform-drag",
    "joint-friction",
    "structure",
    "limb",
    "prior",
    "cutoff",
]


# Name of each kind of correction in words.
NAMES: dict[Kind, str] = {
    "velocity": "recorded velocities excluded",
    "lag": "lag between torques and positions",
    "filter": "filter of torques",
    "hold": "torques held between updates",
    "clock": "clocks that differ",
    "load": "held load",
    "contact": "events excluded",
    "backlash": "play in gears",
    "friction": "friction law",
    "temperature": "friction that warms up",
    "gain": "torque constant",
    "sensor": "sensor",
    "compliance": "gears that wind up",
    "zero": "zero of a drive",
    "gear-ratio": "gear ratio",
    "length": "length",
    "mounting": "mounting of limbs",
    "tilt": "tilt of the base",
    "torque-constant": "torque constant that falls with current",
    "torque-drift": "torque constant that drifts with time",
    "ripple": "ripple",
    "drive-spring": "springs at drives",
    "presliding": "friction that yields before it slips",
    "platform-force": "force at the platform",
    "platform-spring": "spring at the platform",
    "platform-drag": "drag at the platform",
    "joint-friction": "friction of ball joints",
    "structure": "shape of bodies",
    "limb": "limbs that differ",
    "prior": "prior made wider",
    "cutoff": "cut-off of the filter",
}


def cause_in_words(name: str) -> str:
    """Words for an effect's name, such as `tilt`; other text, as 'ripple of drive1, 34', is
    kept."""
    words: dict[str, str] = {str(kind): said for kind, said in NAMES.items()}
    further = {
        "isotropic-spring": "spring at the platform",
        "anisotropic-spring": "spring at the platform that is stiffer in some directions",
    }
    return (words | further).get(name, name)


class Correction(Part):
    """One correction, supported by the recordings.

    Attributes:
        kind: what was corrected.
        subject: drive, joint or body; empty for all of them.
        log: the recording that was corrected; empty for the model.
        value: size of the correction, if it has one, with a 95 % interval if that is known.
        unit: of value and interval.
        text: a sentence on the correction and its reason.
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
    """A permanent torque on the drives, caused for example by a hose.

    Attributes:
        name: of the effect, such as 'platform-force'.
        values: of its coefficients.
        drives: that it acts on; empty if it acts on the platform or the struts.
        orders: of ripples, or reciprocals of strokes, one for each drive [1/rad or 1/m]; of a cable
            its fixed point, tension and stiffness about which it is linear [m, N, N/m].
        fastest: speed of the platform by which friction is smoothed near rest [m/s].
    """

    name: str
    values: tuple[float, ...]
    drives: tuple[str, ...] = ()
    orders: tuple[float, ...] = ()
    fastest: float = 0.0


class Inseparable(Part):
    """Two causes of the same torques that the recordings do not separate.

    Attributes:
        causes: the one in the model, and the other.
        subjects: their drives; empty for the whole robot.
        is_counted: whether intervals include both; otherwise they hold the second as described.
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

    `left` is the root mean square of the fit's residual after the low-pass, `largest` the largest
    magnitude of the signal after it; `stated` is the described noise, before the low-pass.
    """

    name: str
    unit: str
    stated: NotNegative
    left: NotNegative
    largest: NotNegative


class FittedSensor(Part):
    """A sensor: its channels, and its own parameters with intervals."""

    name: str
    channels: tuple[FittedChannel, ...]
    parameters: tuple[Parameter, ...] = ()
