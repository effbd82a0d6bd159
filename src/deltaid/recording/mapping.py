"""The user's mapping: which column of a log is what, and in which unit. Declared, never guessed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, PrivateAttr, Tag, model_validator

from deltaid.errors import RecordingError
from deltaid.recording.carried import Load, as_loads
from deltaid.robot.load import load_yaml
from deltaid.robot.part import Part, Positive
from deltaid.shown import Shown

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
# Default names of the time.
TIMES = ("t", "time")
# What may be given for the unit of dates, which have none.
DATES = ("iso", "datetime")


def _numbered(value: object) -> object:
    """A column's number as the name that it has in a log without header."""
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
    """One entry for several columns: those of one array, or a list; of all else one, or a list."""

    column: Name | None = Field(
        default=None, description="array with one column a drive: column[0], column[1], …"
    )
    columns: tuple[Name, ...] | None = Field(
        default=None, description="in place of it: one column a drive"
    )

    @model_validator(mode="after")
    def _check(self) -> "_Several":
        if (self.column is None) == (self.columns is None):
            raise ValueError("needs either column or columns")
        return self

    def names(self, count: int) -> tuple[str, ...]:
        """Of so many columns."""
        return self.columns or tuple(f"{self.column}[{i}]" for i in range(count))

    def each(self, count: int, where: str, wanted: str, cure: str) -> list[dict[str, Any]]:
        """What is said of each of so many columns.

        Args:
            where: for messages, as `wanted` and `cure`.
            wanted: what needs so many.

        Raises:
            RecordingError: a list has another length.
        """
        own = type(self).model_fields.keys() - {"column", "columns"}
        given: dict[str, Any] = {"column": self.names(count)} | {k: getattr(self, k) for k in own}
        for key, value in given.items():
            if isinstance(value, tuple) and len(value) != count:
                what = f"{key if key == 'column' else 'value'}{'s' * (len(value) != 1)}"
                raise RecordingError(
                    f"lists {len(value)} {what}, but {wanted}",
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
        """The same as a list.

        Raises:
            RecordingError: a list has another length than there are drives.
        """
        wanted, cure = f"the robot has {dof} drives", "list one a drive, in order of q"
        return tuple(DriveColumn(**entry) for entry in self.each(dof, where, wanted, cure))


def _spelling(value: object) -> str:
    return "all" if isinstance(value, Mapping | AllDrives) else "each"


DriveColumns = Annotated[
    Annotated[AllDrives, Tag("all")] | Annotated[tuple[DriveColumn, ...], Tag("each")],
    Discriminator(_spelling),
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
        """Whether there is no column: samples follow one another at the rate."""
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
        """The columns of a sensor with so many channels."""
        return (self.column,) if count == 1 and self.column else super().names(count)


class ColumnMapping(Shown, Part):
    """The user's mapping file: columns of a log by address, drives in order of q."""

    time: TimeColumn = Field(default=TimeColumn(), description="when each row was recorded")
    position: DriveColumns | None = Field(default=None, description="of the drives")
    velocity: DriveColumns | None = Field(
        default=None, description="of the drives; made of positions by default"
    )
    acceleration: DriveColumns | None = Field(
        default=None, description="of the drives; made of positions by default"
    )
    torque: DriveColumns | None = Field(
        default=None, description="of the drives, as they drive the joints; forces of rails"
    )
    load: Load | tuple[Load, ...] | None = Field(
        default=None, description="what the robot carries, and when; a list if there are several"
    )
    temperature: TemperatureColumn | None = Field(
        default=None, description="what friction may change with"
    )
    sensors: dict[str, SensorColumns | None] = Field(
        default_factory=dict[str, SensorColumns | None],
        description="columns of the description's sensors, by their names there; null for one "
        "whose columns are not to be used",
    )
    header_row: Annotated[int, Field(ge=1)] = Field(
        default=1,
        description="line of a CSV file of the column names; searched if neither row is given",
    )
    data_row: Annotated[int, Field(json_schema_extra={"minimum": 2})] | None = Field(
        default=None,
        description="line of a CSV file that holds the first numbers; after header_row by default",
    )
    _source: str = PrivateAttr("column mapping")

    @property
    def source(self) -> str:
        """The file it comes from, for messages."""
        return self._source

    def known_as(self, source: str) -> "ColumnMapping":
        """The same, known by the file that it comes from."""
        mapping = self.model_copy()
        mapping._source = source
        return mapping

    @property
    def loads(self) -> tuple[Load, ...]:
        """What the robot carries."""
        return as_loads(self.load)

    @property
    def needed(self) -> tuple[tuple[str, ...], ...]:
        """Names of which a header holds one each: time, and positions of whatever robot."""
        if isinstance(self.position, AllDrives):
            names = self.position.names(1)
        else:
            names = [c.column for c in self.position or ()]
        times = (self.time.column,) if "column" in self.time.model_fields_set else TIMES
        positions = [(name,) for name in names] or [("q1", "q[0]")]
        return (*positions,) if self.time.is_absent else (times, *positions)

    @model_validator(mode="after")
    def _check(self) -> "ColumnMapping":
        if self.data_row is not None and self.data_row <= self.header_row:
            raise ValueError("data_row must come after header_row")
        names = [load.name for load in self.loads]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"two loads are called {twice}; give each a name of its own")
        return self


# A mapping, by value, as a dictionary of the same keys, or the file of one.
MappingLike = ColumnMapping | Mapping[str, Any] | str | Path
# One for all recordings, or one each in their order; None for the default names.
ColumnMappings = MappingLike | Sequence[MappingLike | None] | None


def mapping_each(columns: ColumnMappings, recordings: int) -> list[ColumnMapping | None]:
    """The mapping of each recording.

    Raises:
        RecordingError: there are several, but not as many as recordings; or something is none.
        DescriptionError: a file does not fit.
    """
    if not isinstance(columns, Sequence) or isinstance(columns, str):
        return [as_mapping(columns)] * recordings
    columns = [as_mapping(mapping) for mapping in columns]
    if len(columns) == 1:
        return [columns[0]] * recordings
    if len(columns) not in (0, recordings):
        raise RecordingError(
            f"{len(columns)} mappings are given for {recordings} "
            f"recording{'s' if recordings > 1 else ''}",
            where="columns",
            cure="give one for all recordings, or one for each, in the same order",
        )
    return list(columns) or [None] * recordings


def as_mapping(columns: object) -> ColumnMapping | None:
    """A mapping by value, dictionary or file; None for the default names.

    Raises:
        RecordingError: it is none of these.
        DescriptionError: the file or the dictionary does not fit.
    """
    if columns is None or isinstance(columns, ColumnMapping):
        return columns
    if isinstance(columns, str | Path):
        return load_mapping(columns)
    if isinstance(columns, Mapping):
        return ColumnMapping.from_dict(columns, "columns").known_as("columns")
    raise RecordingError(
        f"a {type(columns).__name__} is no mapping of columns",
        where="columns",
        cure="give deltaid.ColumnMapping(…) or a dictionary of the same keys, the path of a "
        "mapping file, or a list of these with one for each recording",
    )


def load_mapping(path: str | Path) -> ColumnMapping:
    """Read a mapping file.

    Raises:
        DescriptionError: the file does not fit.
    """
    return load_yaml(Path(path), ColumnMapping).known_as(str(path))
