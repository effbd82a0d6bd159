"""Mappings: columns of a log by quantity, with their units.

The user declares a mapping, or it is proposed with reasons and doubts for each quantity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, model_validator

from deltaid.errors import RecordingError, counted
from deltaid.files import written_whole
from deltaid.recording.carried import Load
from deltaid.recording.mapped_columns import (
    QUANTITIES,
    TIMES,
    AllDrives,
    DriveColumns,
    SensorColumns,
    TemperatureColumn,
    TimeColumn,
)
from deltaid.robot.load import load_yaml, yaml_text
from deltaid.robot.part import Part
from deltaid.shown import Shown

# Source of a mapping that was proposed with certainty and used.
FOUND = "columns found"


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
        description="line of a CSV file of the column names; searched if it is not given",
    )
    data_row: Annotated[int, Field(json_schema_extra={"minimum": 2})] | None = Field(
        default=None,
        description="line of a CSV file that holds the first numbers; after header_row by default",
    )
    _source: str = PrivateAttr("column mapping")

    @property
    def source(self) -> str:
        """Name of the mapping's file, for messages."""
        return self._source

    def known_as(self, source: str) -> "ColumnMapping":
        """Copy of the mapping with the name of its file."""
        mapping = self.model_copy()
        mapping._source = source
        return mapping

    @property
    def loads(self) -> tuple[Load, ...]:
        """Loads that the robot carries."""
        return (self.load,) if isinstance(self.load, Load) else self.load or ()

    @property
    def needed(self) -> tuple[tuple[str, ...], ...]:
        """Possible names of the time and of each position; a header has one of each."""
        given = self.position
        all_at_once = isinstance(given, AllDrives)
        names = given.names(1) if all_at_once else [c.column for c in given or ()]
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


# A mapping, a dictionary with its keys, or the path of its file.
MappingLike = ColumnMapping | Mapping[str, Any] | str | Path
# One mapping for all recordings, or one each in their order; None for the default names.
ColumnMappings = MappingLike | Sequence[MappingLike | None] | None


def mapping_each(columns: ColumnMappings, recordings: int) -> list[ColumnMapping | None]:
    """Mapping of each recording; None for the default names.

    Args:
        recordings: number of recordings.

    Raises:
        RecordingError: the number of mappings is wrong, or one is no mapping.
        DescriptionError: a file or a dictionary is invalid.
    """
    each = columns if isinstance(columns, Sequence) and not isinstance(columns, str) else [columns]
    mappings = [as_mapping(mapping) for mapping in each] or [None]
    if len(mappings) not in (1, recordings):
        raise RecordingError(
            f"{len(mappings)} mappings are given for {counted(recordings, 'recording')}",
            where="columns",
            cure="give one for all recordings, or one for each, in the same order",
        )
    return mappings * (recordings if len(mappings) == 1 else 1)


def as_mapping(columns: object) -> ColumnMapping | None:
    """Convert a dictionary or a file to a mapping; None stands for the default names.

    Raises:
        RecordingError: `columns` is of another type.
        DescriptionError: the file or the dictionary is invalid.
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
        DescriptionError: the file cannot be read or is invalid.
    """
    return load_yaml(Path(path), ColumnMapping).known_as(str(path))


@dataclass(frozen=True)
class FoundColumns:
    """Proposed columns of one quantity.

    Attributes:
        quantity: time, position, velocity, acceleration or torque.
        columns: addresses of the columns, one per drive, or one for the time.
        units: one unit per column; empty text if none can be proposed.
        reasons: reasons for these columns and units.
        doubts: doubts about the columns.
        assumed: why the unit is a guess; empty if it is certain.
    """

    quantity: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    reasons: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    assumed: str = ""

    @property
    def unit(self) -> str:
        """Unit of all columns; empty if none can be proposed, or if units differ."""
        return self.units[0] if len({*self.units}) == 1 else ""

    @property
    def open_questions(self) -> tuple[str, ...]:
        """All doubts; empty if columns and units are certain."""
        return (*self.doubts, self.assumed) if self.assumed else self.doubts


@dataclass(frozen=True)
class MappingProposal:
    """Proposed mapping with reasons and doubts.

    Attributes:
        data: content of the mapping's file.
        found: columns of each quantity, with reasons and doubts.
        missing: needed quantities, units or torque_constant that were not found.
        warnings: warnings about the layout of the recording.
    """

    data: dict[str, Any]
    found: tuple[FoundColumns, ...]
    missing: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons and assumptions, one sentence per quantity."""
        return tuple(
            f"{part.quantity}: {', '.join(part.columns)}; "
            + "; ".join((*part.reasons, *part.open_questions))
            for part in self.found
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts about columns and units, one sentence each."""
        return tuple(f"{p.quantity}: {text}" for p in self.found for text in p.open_questions)

    @property
    def complete(self) -> bool:
        """Whether all needed quantities and units were found."""
        return not self.missing

    @property
    def certain(self) -> bool:
        """Whether the proposal is complete and has no doubts."""
        return self.complete and not self.doubts

    @property
    def mapping(self) -> ColumnMapping:
        """Mapping to give as `columns=`.

        Raises:
            DescriptionError: a needed quantity or unit was not found.
        """
        return ColumnMapping.from_dict(self.data, "proposed columns").known_as("proposed columns")

    def save(self, path: str | Path) -> None:
        """Write the proposal as a mapping file.

        Raises:
            RecordingError: a needed quantity or unit was not found.
            DeltaidError: the file cannot be written.
        """
        if self.missing:
            raise RecordingError(
                f"no mapping is written: {', '.join(self.missing)} not found",
                where=str(path),
                cure="give units, gear or torque_constant with the call "
                "(--unit torque='0.0235 N*m', --torque-constant 0.1), or write the file by hand",
            )
        with written_whole(Path(path)) as file:
            file.write(yaml_text(self.data))


@dataclass(frozen=True)
class Known:
    """Properties of columns that the user states.

    Attributes:
        units: units by quantity.
        gear: motor revolutions per joint revolution; None if columns are of the joints.
        torque_constant: torque constant at the motor [N m/A], for currents.
    """

    units: Mapping[str, str] = field(default_factory=dict[str, str])
    gear: float | None = None
    torque_constant: float | None = None


def as_words(mapping: ColumnMapping) -> str:
    """Proposed mapping in words: 'columns are found: time t [s]; position a, b, c [deg]'."""
    parts = [f"time {mapping.time.column} [{mapping.time.unit}]"]
    for quantity in QUANTITIES:
        if drives := getattr(mapping, quantity) or ():
            names = ", ".join(drive.column for drive in drives)
            units = ", ".join(dict.fromkeys(drive.unit for drive in drives))
            parts.append(f"{quantity} {names} [{units}]")
    return f"columns are found: {'; '.join(parts)}"
