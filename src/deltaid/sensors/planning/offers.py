"""Offers: measurements and sensors that could be bought, as a YAML list, shipped or a user's own.

Prices and hours of the shipped list are assumptions; a plan (`sensors.planning.plan`) decides what
each offer is worth for a robot.
"""

from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from deltaid.robot.load import load_yaml, parse
from deltaid.robot.measured import Count, MeasuredQuantity, MeasuredTogether, Placed, require_axis
from deltaid.robot.part import Axis, NotNegative, Part, Point, Positive, Vector
from deltaid.robot.sensors import Sensor, Share
from deltaid.shown import Shown

# Words for bodies, axes and places of any robot.
EACH, LIMB, ALONG, ACROSS, CENTRE = "each", "limb", "along", "across", "centre"

# Keys of an offer that name its use.
USED_FOR = ("weigh", "measured", "sensors", "reads")
PoseKind = Literal["points", "probe", "distances"]

_SHIPPED = "catalogue.yaml"


class Weigh(Part):
    """One value of a body that could be measured, as in `measured:` of a robot, but still unknown.

    Its standard deviation is √(std² + (share · value)²) with the value at the prior.
    """

    quantity: MeasuredQuantity = Field(description="what is measured of it")
    of: str | dict[str, Count] | tuple[Placed, ...] = Field(
        default=EACH,
        description="a body, several, or where each was, as in `measured:`; or `each` body by "
        "itself, or a `limb`: arm or carriage with its struts",
    )
    axis: Axis | Literal["along", "across"] | Vector | None = Field(
        default=None,
        description="x, y, z or a direction; or `along` the body's longest axis of these three, or "
        "`across` it; needed by all but mass",
    )
    about: Point | Literal["centre"] = Field(
        default=CENTRE,
        description="a point of the axis that inertia is about, m; or the body's `centre` of mass",
    )
    std: NotNegative = Field(default=0.0, description="standard deviation, in its unit")
    share: Share = Field(default=0.0, description="standard deviation as a share of the value")

    @model_validator(mode="after")
    def _check(self) -> "Weigh":
        if self.std == 0 and self.share == 0:
            raise ValueError("gives neither std nor share; nothing is measured exactly")
        require_axis(self.quantity, self.axis, "x, y, z, along, across or a direction")
        if self.quantity == "centre" and self.std == 0:
            raise ValueError("centre needs std, in m; a share of a position means nothing")
        if self.quantity == "centre" and self.of == LIMB:
            raise ValueError(f"centre of a {LIMB} means nothing; say of which bodies, and where")
        return self


class PoseReadings(Part):
    """How an instrument measures poses for `deltaid calibrate`."""

    kind: PoseKind = Field(description="3-D points, touches of a plane, or distances")
    noise: Positive = Field(description="standard deviation of a reading, m")
    blocks: tuple[NotNegative, ...] = Field(
        default=(0.0,), description="heights of what a probe touches above the plane, m"
    )


class Offer(Part):
    """One thing to buy, and what can be done with it: one of `weigh`, `measured`, `sensors`,
    `reads`."""

    title: str = Field(min_length=1, description="what it is, as in tables")
    price: NotNegative = Field(description="paid once, however often it is used")
    hours: NotNegative = Field(
        default=0.0, description="work of each use: a body that is weighed, sensors that are fitted"
    )
    weigh: Weigh | tuple[Weigh, ...] = Field(
        default=(), description="values of bodies that could be measured with it"
    )
    measured: tuple[MeasuredTogether, ...] = Field(
        default=(), description="as in a robot's file, where values are known already"
    )
    sensors: dict[str, Sensor] = Field(
        default_factory=dict[str, Sensor],
        description="as in a robot's file, all of them together; `strut: each` is one on the "
        "struts of every limb, `drive: each` on every drive, price and hours being those of one",
    )
    reads: PoseReadings | None = Field(
        default=None, description="poses that it measures, for `deltaid calibrate`"
    )
    group: str = Field(
        default="", description="of offers of one group, such as two force plates, one is bought"
    )
    remark: str = Field(default="", description="where price and noise come from")

    @property
    def weighs(self) -> tuple[Weigh, ...]:
        return (self.weigh,) if isinstance(self.weigh, Weigh) else self.weigh

    @model_validator(mode="after")
    def _check(self) -> "Offer":
        given = [key for key in USED_FOR if getattr(self, key)]
        if len(given) != 1:
            raise ValueError(
                f"gives {' and '.join(given) or 'nothing to do with it'}: give one of "
                f"{', '.join(USED_FOR)}"
            )
        return self


Key = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class Offers(Shown, Part):
    """A list of what could be bought.

    `combinations` name uses that are tried together, such as [kitchen-scale:S, kitchen-scale:P].
    """

    currency: str = Field(default="EUR", min_length=1, description="of all prices")
    hourly: NotNegative = Field(default=50.0, description="what an hour of work costs")
    offers: dict[Key, Offer] = Field(
        min_length=1, description="what could be bought or done, by short names"
    )
    combinations: tuple[tuple[str, ...], ...] = Field(
        default=(), description="uses that are tried together"
    )


def load_offers(path: str | Path) -> Offers:
    """A user's list.

    Raises:
        DescriptionError: it cannot be read, or something in it is wrong.
    """
    return load_yaml(Path(path), Offers)


@cache
def shipped_offers() -> Offers:
    return parse(shipped_text(), Offers, where=_SHIPPED)


def shipped_text() -> str:
    """Text of its file, a start for a list of your own."""
    return (resources.files("deltaid.sensors.planning") / _SHIPPED).read_text(encoding="utf-8")
