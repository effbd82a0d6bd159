"""Which columns of a log are a sensor's, and in which units: the entry of a mapping."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from deltaid.recording.column_name import Name
from deltaid.robot.part import Part

Sign = Literal[1, -1]
Delay = Annotated[float, Field(ge=-1, le=1)]


class SensorColumns(Part):
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
        "for each volt; that of the log if left out, else N and N*m",
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

    @model_validator(mode="after")
    def _check(self) -> "SensorColumns":
        if (self.column is None) == (self.columns is None):
            raise ValueError("needs either column or columns")
        return self

    def names(self, channels: int) -> tuple[str, ...]:
        """The columns of a sensor with so many channels."""
        if self.columns is not None:
            return self.columns
        if channels == 1:
            return (str(self.column),)
        return tuple(f"{self.column}[{i}]" for i in range(channels))
