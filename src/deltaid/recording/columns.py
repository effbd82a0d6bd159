"""Which column of a log is what, and in which unit. Units are declared, never guessed."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field

from deltaid.errors import RecordingError
from deltaid.robot.load import load_yaml
from deltaid.robot.shapes import Positive

if TYPE_CHECKING:
    import pint

Quantity = Literal["position", "velocity", "acceleration", "torque"]
QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration", "torque")
_SHORT = {"position": "q", "velocity": "qd", "acceleration": "qdd", "torque": "tau"}
_UNIT = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s^2",
    "torque": "N*m",
}


class DriveColumn(BaseModel):
    """One column of one drive, and how its numbers become SI at the robot's joint.

    joint value = sign · unit · (number − zero) / gear for motion, and
    joint torque = sign · unit · torque_constant · (number − zero) · gear for torque.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    column: str
    unit: str = Field(description="such as deg, rpm, mN*m, or A with a torque_constant")
    gear: Positive = Field(default=1.0, description="motor revolutions per joint revolution")
    sign: Literal[1, -1] = Field(default=1, description="-1 if the column counts the other way")
    zero: float = Field(default=0.0, description="the column's number where the joint value is 0")
    torque_constant: Positive | None = Field(
        default=None, description="N m per A at the motor, for torque columns in ampere"
    )


class TimeColumn(BaseModel):
    """The time column."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    column: str = "t"
    unit: str = "s"


class ColumnMapping(BaseModel):
    """The user's mapping file: columns of a log by name, one entry a drive in order of q."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time: TimeColumn = TimeColumn()
    position: tuple[DriveColumn, ...] | None = None
    velocity: tuple[DriveColumn, ...] | None = None
    acceleration: tuple[DriveColumn, ...] | None = None
    torque: tuple[DriveColumn, ...] | None = None


@dataclass(frozen=True)
class Channel:
    """One column with the affine map to SI: value = scale · (number − zero)."""

    column: str
    scale: float
    zero: float


@dataclass(frozen=True)
class Columns:
    """Channels of a log; a quantity that the log does not have is empty."""

    time: Channel
    position: tuple[Channel, ...]
    velocity: tuple[Channel, ...]
    acceleration: tuple[Channel, ...]
    torque: tuple[Channel, ...]

    @property
    def all(self) -> tuple[Channel, ...]:
        """All channels, time first."""
        drives = self.position + self.velocity + self.acceleration + self.torque
        return (self.time, *drives)


def load_mapping(path: Path) -> ColumnMapping:
    """Read a mapping file.

    Raises:
        DescriptionError: the file does not fit.
    """
    return load_yaml(path, ColumnMapping)


def resolve_columns(
    header: tuple[str, ...], dof: int, mapping: ColumnMapping | None, *, where: str
) -> Columns:
    """Match a log's header with a mapping, or with the default names t, q1…, qd1…, qdd1…, tau1….

    The default names are in s, rad, rad/s, rad/s² and N m at the joint.

    Raises:
        RecordingError: a column is missing, a unit does not fit, or a list has the wrong length.
    """
    mapping = mapping or ColumnMapping()
    time_scale = _factor(mapping.time.unit, "s", None, where="time.unit")
    channels = {
        quantity: _channels(quantity, header, dof, getattr(mapping, quantity))
        for quantity in QUANTITIES
    }
    columns = Columns(Channel(mapping.time.column, time_scale, 0.0), **channels)
    missing = [c.column for c in columns.all if c.column not in header]
    if not columns.position:
        missing += [f"q{i + 1}" for i in range(dof)]
    if missing:
        raise RecordingError(
            f"has no column {', '.join(missing)}; its columns are {', '.join(header)}",
            where=where,
            cure="rename the columns to t, q1…, tau1… (and qd1…, qdd1… if recorded), or say which "
            "is which with --columns MAPPING.yaml",
        )
    return columns


def _channels(
    quantity: Quantity,
    header: tuple[str, ...],
    dof: int,
    given: tuple[DriveColumn, ...] | None,
) -> tuple[Channel, ...]:
    if given is None:
        names = [f"{_SHORT[quantity]}{i + 1}" for i in range(dof)]
        present = [name for name in names if name in header]
        # Some but not all: keep them all, so that the missing ones are named.
        return tuple(Channel(name, 1.0, 0.0) for name in names) if present else ()
    if len(given) != dof:
        raise RecordingError(
            f"{quantity} lists {len(given)} columns, but the robot has {dof} drives",
            where="column mapping",
        )
    return tuple(_channel(quantity, c, f"{quantity}[{i}]") for i, c in enumerate(given))


def _channel(quantity: Quantity, column: DriveColumn, where: str) -> Channel:
    if quantity == "torque":
        factor = _factor(column.unit, _UNIT[quantity], column.torque_constant, where=where)
        return Channel(column.column, column.sign * factor * column.gear, column.zero)
    if column.torque_constant is not None:
        raise RecordingError("torque_constant belongs to torque columns", where=where)
    factor = _factor(column.unit, _UNIT[quantity], None, where=where)
    return Channel(column.column, column.sign * factor / column.gear, column.zero)


def _factor(unit: str, target: str, torque_constant: float | None, *, where: str) -> float:
    """The number by which values in `unit` become values in `target`."""
    if unit == target:
        return 1.0
    import pint

    registry = _registry()
    try:
        one = registry.Quantity(1.0, unit)
        if torque_constant is not None:
            one = one * registry.Quantity(torque_constant, "N*m/A")
        return float(one.m_as(target))
    except pint.DimensionalityError:
        hint = "; a current needs a torque_constant in N m/A" if target == "N*m" else ""
        raise RecordingError(
            f"unit '{unit}' is not a unit of {target}{hint}", where=f"column mapping, {where}"
        ) from None
    except (pint.PintError, AttributeError, ValueError, TypeError, AssertionError):
        raise RecordingError(
            f"unit '{unit}' is not known",
            where=f"column mapping, {where}",
            cure="write it as in deg, rad, rpm, deg/s, rad/s^2, N*m, mN*m, A, ms",
        ) from None


@cache
def _registry() -> "pint.UnitRegistry":
    import pint

    return pint.UnitRegistry()
