"""A mapping that is proposed: the columns of each quantity, with reasons and doubts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltaid.errors import RecordingError
from deltaid.files import written_whole
from deltaid.recording.mapped_columns import QUANTITIES
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.load import yaml_text

# The source of a mapping that nobody gave: one that is found with certainty.
FOUND = "columns found"


@dataclass(frozen=True)
class FoundColumns:
    """The columns of one quantity.

    Attributes:
        quantity: time, position, velocity, acceleration or torque.
        columns: one a drive; of time one.
        units: as a mapping has them, one a column; empty where none can be proposed.
        reasons: why these, and why in this unit.
        doubts: which other columns it may be.
        assumed: why the unit is a guess; empty where it is none.
    """

    quantity: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    reasons: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    assumed: str = ""

    @property
    def unit(self) -> str:
        """The unit of all columns; empty if none can be proposed, or they differ."""
        return self.units[0] if len({*self.units}) == 1 else ""

    @property
    def open_questions(self) -> tuple[str, ...]:
        """All that is in doubt; nothing if it is certain."""
        return (*self.doubts, self.assumed) if self.assumed else self.doubts

    @property
    def sentence(self) -> str:
        """All of it in one line."""
        words = "; ".join((*self.reasons, *self.open_questions))
        return f"{self.quantity}: {', '.join(self.columns)}; {words}"


@dataclass(frozen=True)
class MappingProposal:
    """A mapping that may be right.

    Attributes:
        data: as its file would hold it.
        found: the columns of each quantity, with reasons and doubts.
        missing: what is needed and was not found: quantities, units, a torque_constant.
    """

    data: dict[str, Any]
    found: tuple[FoundColumns, ...]
    missing: tuple[str, ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why, one sentence a quantity; what is assumed says so."""
        return tuple(columns.sentence for columns in self.found)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What else columns and units may be, one sentence each."""
        return tuple(f"{p.quantity}: {text}" for p in self.found for text in p.open_questions)

    @property
    def complete(self) -> bool:
        """Whether a check can begin with it."""
        return not self.missing

    @property
    def certain(self) -> bool:
        """Whether it is complete and nothing of it is in doubt."""
        return self.complete and not self.doubts

    @property
    def mapping(self) -> ColumnMapping:
        """The same as a value, to be given as `columns=`.

        Raises:
            DescriptionError: a quantity or a unit that is needed was not found.
        """
        return ColumnMapping.from_dict(self.data, "proposed columns").known_as("proposed columns")

    def save(self, path: str | Path) -> None:
        """Write it as a mapping file, to be read and corrected.

        Raises:
            RecordingError: something that is needed was not found.
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
    """What the user says of columns, whatever their names.

    Attributes:
        units: by quantity.
        gear: motor revolutions per joint revolution; None where columns are of the joints.
        torque_constant: N m per A at the motor, for currents.
    """

    units: Mapping[str, str] = field(default_factory=dict[str, str])
    gear: float | None = None
    torque_constant: float | None = None


def as_words(mapping: ColumnMapping) -> str:
    """'columns are found: time t [s]; position a, b, c [deg]', of a mapping that is found."""
    parts = [f"time {mapping.time.column} [{mapping.time.unit}]"]
    for quantity in QUANTITIES:
        drives: Any = getattr(mapping, quantity) or ()
        units = ", ".join(dict.fromkeys(drive.unit for drive in drives))
        parts += [f"{quantity} {', '.join(drive.column for drive in drives)} [{units}]"] * bool(
            drives
        )
    return f"columns are found: {'; '.join(parts)}"
