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
    "prior",
    "cutoff",
]


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
