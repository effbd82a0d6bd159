"""User-defined mechanism in a description.

The geometry is a function in a Python file (`mechanism.user_code`). The description states what
must be known without running it: drives, bodies, joints, the checksum of the file. A description
never runs a file: the user names it on the command line or by `use_mechanism`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, model_validator

from deltaid.errors import DescriptionError, counted
from deltaid.robot.limits import NAMES, Task, TaskName
from deltaid.robot.part import (
    TOOL_ACCELERATION,
    TOOL_SPEED,
    JointKind,
    Part,
    ToolAcceleration,
    ToolAngles,
    ToolSpeed,
)

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")]


@dataclass(frozen=True)
class NamedFile:
    """Python file that the user has named, its SHA-256, and the function that it defines."""

    path: str
    sha256: str
    function: Callable[..., Any]


# The file in use, at most one.
_named: list[NamedFile] = []


class OwnMechanism(Part):
    """A mechanism whose geometry is a Python function."""

    drives: tuple[JointKind, ...] = Field(
        min_length=1, max_length=4, description="kind of each drive, as many as coordinates"
    )
    coordinates: tuple[TaskName, ...] | None = Field(
        default=None,
        description="what z consists of, some of x, y, z, psi in this order; x, y, z for three "
        "drives, and psi for the fourth, if not given",
    )
    bodies: tuple[Name, ...] = Field(min_length=1, description="names of the bodies, in order")
    joints: dict[Name, JointKind] = Field(
        default_factory=dict, description="further joints that may have friction or springs"
    )
    angle_deg: ToolAngles = (-180.0, 180.0)
    speed_deg_s: ToolSpeed = TOOL_SPEED
    acceleration_deg_s2: ToolAcceleration = TOOL_ACCELERATION
    sha256: str | None = Field(
        default=None, description="of the Python file; filled in when the file is named"
    )

    @model_validator(mode="after")
    def _check(self) -> "OwnMechanism":
        self._check_coordinates()
        if len(set(self.bodies)) != len(self.bodies):
            raise ValueError("bodies has a name twice")
        clash = [name for name in self.joints if name.startswith("drive")]
        if clash:
            raise ValueError(f"joints has {clash[0]}, which is a drive's name")
        return self

    def _check_coordinates(self) -> None:
        count, given = len(self.drives), self.coordinates
        if given is None and count < 3:
            raise ValueError(
                f"has {counted(count, 'drive')}, so say which coordinates they "
                "move, such as coordinates: " + ("[x]" if count == 1 else "[x, z]")
            )
        if given is not None and len(given) != count:
            raise ValueError(
                f"has {count} drives, but {len(given)} coordinates; there is one for each drive"
            )
        if list(given or ()) != [name for name in NAMES if name in (given or ())]:
            raise ValueError("coordinates must be given once each, in the order x, y, z, psi")

    @property
    def task(self) -> Task:
        """Names of the task coordinates z."""
        return Task(self.coordinates or NAMES[: len(self.drives)])


def name_file(file: NamedFile) -> None:
    """Set the file that the user has named; it replaces an earlier one."""
    _named[:] = [file]


def named_file() -> NamedFile | None:
    """Python file that the user has named last; None if none."""
    return _named[0] if _named else None


def file_of(own: OwnMechanism, where: str) -> NamedFile:
    """The file of a mechanism, which the user has named.

    Raises:
        DescriptionError: no file has been named, or the description belongs to another one.
    """
    cure = "name it: deltaid --mechanism FILE.py COMMAND …, or deltaid.use_mechanism('FILE.py')"
    file = named_file()
    if file is None:
        raise DescriptionError(
            "has a mechanism of its own, whose geometry is in a Python file", where=where, cure=cure
        )
    if own.sha256 not in (None, file.sha256):
        raise DescriptionError(
            f"belongs to a Python file with SHA-256 {str(own.sha256)[:12]}…, but the one that was "
            f"named has {file.sha256[:12]}…",
            where=where,
            cure="name the file that it was made with, or take mechanism.sha256 out of it",
        )
    return file
