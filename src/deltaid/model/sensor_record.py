"""Sensors beside the drives, as a fit found them, for the model file."""

from typing import Annotated

from pydantic import Field

from deltaid.model.parameter_record import Parameter
from deltaid.robot.part import Part

NotNegative = Annotated[float, Field(ge=0)]


class FittedChannel(Part):
    """One number that a sensor shows.

    `left` is the root mean square of what the fit leaves of it after the low-pass, `largest` the
    largest magnitude there; `stated` is the noise that the description gives, before the low-pass.
    """

    name: str
    unit: str
    stated: NotNegative
    left: NotNegative
    largest: NotNegative


class FittedSensor(Part):
    """A sensor: its channels, and what was unknown of itself, with intervals."""

    name: str
    channels: tuple[FittedChannel, ...]
    parameters: tuple[Parameter, ...] = ()
