"""Entries of a mapping: columns of drives, time, temperature and sensors, with their units."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from deltaid.errors import RecordingError, counted
from deltaid.robot.part import Part, Positive, require_one

Sign = Literal[1, -1]
Delay = Annotated[float, Field(ge=-1, le=1)]
Quantity = Literal["position", "velocity", "acceleration", "torque"]
# Default names of their columns, without the drives' numbers.
SHORT_NAMES: dict[Quantity, str] = {
    "position": "q",
    "velocity": "qd",
    "acceleration": "qdd",
    "torque": "tau",
}
QUANTITIES = tuple(SHORT_NAMES)
# Quantities that an identification needs: those of each drive, and all.
NEEDED_OF_DRIVES: tuple[Quantity, ...] = ("position", "torque")
NEEDED = ("time", *NEEDED_OF_DRIVES)
# Default names of the time.
TIMES = ("t", "time")
# Words that are allowed as the unit of dates.
DATES = ("iso", "datetime")


def _numbered(value: object) -> object:
    """Convert a column's number to its name in a log without header."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Name = Annotated[
    str,
    BeforeValidator(_numbered, json_schema_input_type=str | int),
    Field(min_length=1, description="as in the log's header; its number from 1 if there is none"),
]


class DriveColumn(Part):
    """One column of one drive, and how its numbers become SI at the robot's joint.

    joint value = sign · unit · (number − zero) / gear for motion, and
    joint torque = sign · unit · torque_constant · (number − zero) · gear for torque. With a `lead`
    the unit is one of the turning motor, and a revolution of it moves a linear drive that far.
    """

    column: Name
    unit: str = Field(
        description="such as deg, rpm, mN*m, or A with a torque_constant; a number may stand "
        "before it, such as 0.0235 N*m for per mille of 23.5 N m"
    )
    gear: Positive = Field(default=1.0, description="motor revolutions per joint revolution")
    lead: Positive | None = Field(
        default=None,
        description="m per revolution of spindle or belt pulley, for a linear drive whose column "
        "is of the motor",
    )
    sign: Sign = Field(default=1, description="-1 if the column counts the other way")
    zero: float = Field(default=0.0, description="the column's number where the joint value is 0")
    torque_constant: Positive | None = Field(
        default=None, description="N m per A at the motor, for torque columns in ampere"
    )


class _Several(Part):
    """One entry for several columns: one array or a list of columns, and other keys with one value
    for all columns or a list."""

    column: Name | None = Field(
        default=None, description="array with one column a drive: column[0], column[1], …"
    )
    columns: tuple[Name, ...] | None = Field(
        default=None, description="in place of it: one column a drive"
    )

    @model_validator(mode="after")
    def _check(self) -> "_Several":
        require_one(self, "column", "columns")
        return self

    def names(self, count: int) -> tuple[str, ...]:
        """Names of `count` columns, listed or of the array."""
        return self.columns or tuple(f"{self.column}[{i}]" for i in range(count))

    def each(self, count: int, where: str, wanted: str, cure: str) -> list[dict[str, Any]]:
        """Entries of `count` columns, one each.

        Args:
            where, cure: place and fix for messages.
            wanted: reason for this number, for messages.

        Raises:
            RecordingError: a list has another length.
        """
        keys = type(self).model_fields.keys() - {"column", "columns"}
        given: dict[str, Any] = {"column": self.names(count)} | {k: getattr(self, k) for k in keys}
        for key, value in given.items():
            if isinstance(value, tuple) and len(value) != count:
                what = counted(len(value), "column" if key == "column" else "value")
                raise RecordingError(
                    f"lists {what}, but {wanted}",
                    where=f"{where}.{'columns' if key == 'column' else key}",
                    cure=cure if key == "column" else f"{cure}, or give one value for all",
                )
        split = {k: x if isinstance(x, tuple) else (x,) * count for k, x in given.items()}
        return [{key: values[i] for key, values in split.items()} for i in range(count)]


class AllDrives(_Several):
    """One entry for all drives, in place of a list with one a drive.

    Columns are those of one array, or are listed; of all else there is one for all, or a list.
    """

    unit: str | tuple[str, ...] = Field(description="such as deg, rpm, mN*m")
    gear: Positive | tuple[Positive, ...] = Field(
        default=1.0, description="motor revolutions per joint revolution"
    )
    lead: Positive | tuple[Positive, ...] | None = Field(
        default=None, description="m per revolution of spindle or belt pulley"
    )
    sign: Sign | tuple[Sign, ...] = Field(
        default=1, description="-1 if the column counts the other way"
    )
    zero: float | tuple[float, ...] = Field(
        default=0.0, description="the column's number where the joint value is 0"
    )
    torque_constant: Positive | tuple[Positive, ...] | None = Field(
        default=None, description="N m per A at the motor"
    )

    def entries(self, dof: int, where: str) -> tuple[DriveColumn, ...]:
        """One entry per drive.

        Raises:
            RecordingError: a list does not have one item per drive.
        """
        wanted, cure = f"the robot has {dof} drives", "list one a drive, in order of q"
        return tuple(DriveColumn(**entry) for entry in self.each(dof, where, wanted, cure))


DriveColumns = Annotated[
    Annotated[AllDrives, Tag("all")] | Annotated[tuple[DriveColumn, ...], Tag("each")],
    Discriminator(lambda value: "all" if isinstance(value, Mapping | AllDrives) else "each"),
]


class TimeColumn(Part):
    """The time column, or what takes its place.

    A column with a unit holds times; one with a rate counts cycles; a rate alone stands for the
    time of a log without.
    """

    column: Name = "t"
    unit: str = Field(
        default="s",
        description="such as s, ms, 100 ns; dates and times of day (ISO 8601) have none",
    )
    rate: Positive | None = Field(
        default=None,
        description="samples a second, in place of a time column; or what a column counts a second",
    )

    @property
    def is_absent(self) -> bool:
        """Whether the log has no time column, so that the rate determines the times."""
        return self.rate is not None and "column" not in self.model_fields_set

    @model_validator(mode="after")
    def _check(self) -> "TimeColumn":
        if self.rate is not None and "unit" in self.model_fields_set:
            raise ValueError(
                "gives unit and rate: a column of times has a unit, one that counts cycles a rate, "
                "and a log without time the rate alone"
            )
        return self


class TemperatureColumn(Part):
    """The column of a temperature that friction may follow, of a motor, a gear or the oil."""

    column: Name
    unit: Literal["degC", "K", "degF"] = Field(default="degC", description="of the column")


class SensorColumns(_Several):
    """The columns of one sensor, in the order of its channels: Fx, Fy, Fz, Mx, My, Mz of a wrench.

    SI value = sign · unit · (number − zero). Of unit, sign and zero there is one for all columns,
    or a list.
    """

    column: Name | None = Field(
        default=None, description="of a sensor with one channel; of more an array: column[0], …"
    )
    columns: tuple[Name, ...] | None = Field(
        default=None, description="in place of it: one column a channel"
    )
    unit: str | tuple[str, ...] | None = Field(
        default=None,
        description="such as N, kN, lbf, N*m, mN*m; a number may stand before it, such as 12.5 N "
        "for each volt; by default that of the log, else N and N*m",
    )
    sign: Sign | tuple[Sign, ...] = Field(
        default=1, description="-1 if a column counts the other way"
    )
    zero: float | tuple[float, ...] = Field(
        default=0.0, description="the column's number where the sensor shows nothing"
    )

    delay: Delay = Field(
        default=0.0, description="how much later than the motion it is recorded, s"
    )

    def names(self, count: int) -> tuple[str, ...]:
        """Names of the columns of a sensor with `count` channels."""
        return (self.column,) if count == 1 and self.column else super().names(count)
