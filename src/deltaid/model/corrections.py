"""What an identification put right in its recordings or added to its model, for the model file."""

from typing import Annotated, Literal

from pydantic import Field

from deltaid.robot.part import Part

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
    "ripple",
    "drive-spring",
    "platform-force",
    "structure",
    "prior",
    "cutoff",
]


# What each kind is, in words.
NAMES: dict[Kind, str] = {
    "velocity": "recorded velocities left out",
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
    """One thing that was put right, on the evidence of the recordings.

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
