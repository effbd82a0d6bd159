"""A mechanism that is the user's own: what a description says of it, and the Python file behind it.

The geometry is a function in a Python file (`mechanism.own`). The description says what has to be
known without running it: drives, bodies, joints. Running a file is never a description's doing: the
user names the file, on the command line or by `use_mechanism`.
"""

import hashlib
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from deltaid.errors import DescriptionError
from deltaid.robot.part import Part
from deltaid.robot.quantities import Coordinate, Positive

JointKind = Literal["rotary", "linear"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")]

# The function that a Python file has to define.
FUNCTION = "mechanism"


@dataclass(frozen=True)
class NamedFile:
    """A Python file that the user has named, and the function that it defines."""

    path: str
    function: Callable[..., Any]


_named: dict[str, NamedFile] = {}


class OwnMechanism(Part):
    """A mechanism whose geometry is a Python function."""

    drives: tuple[JointKind, ...] = Field(
        min_length=3,
        max_length=4,
        description="kind of each drive; three for z = (x, y, z), four for z = (x, y, z, ψ)",
    )
    bodies: tuple[Name, ...] = Field(min_length=1, description="names of the bodies, in order")
    joints: dict[Name, JointKind] = Field(
        default_factory=dict, description="further joints that may have friction or springs"
    )
    angle_deg: tuple[Coordinate, Coordinate] = Field(
        default=(-180.0, 180.0), description="lowest and highest tool angle ψ, degrees"
    )
    speed_deg_s: Positive = Field(default=1500.0, description="largest tool speed, degrees/s")
    acceleration_deg_s2: Positive = Field(
        default=30_000.0, description="largest tool acceleration, degrees/s²"
    )
    sha256: str | None = Field(
        default=None, description="of the Python file; filled in when the file is named"
    )

    @model_validator(mode="after")
    def _check(self) -> "OwnMechanism":
        if len(set(self.bodies)) != len(self.bodies):
            raise ValueError("bodies has a name twice")
        clash = [name for name in self.joints if name.startswith("drive")]
        if clash:
            raise ValueError(f"joints has {clash[0]}, which is a drive's name")
        if self.angle_deg[0] >= self.angle_deg[1]:
            raise ValueError("angle_deg must be given as [lowest, highest]")
        return self


def use_mechanism(path: str | Path) -> str:
    """Run a Python file that defines `mechanism(z)`, for descriptions that have one of their own.

    Returns its SHA-256, by which descriptions and models know the file.

    Raises:
        DescriptionError: the file cannot be read or run, or does not define the function.
    """
    path = Path(path)
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        found = runpy.run_path(str(path)).get(FUNCTION)
    except OSError as error:
        reason = error.strerror or error
        raise DescriptionError(
            f"cannot be read: {reason}", where=str(path), cure="check its name and permissions"
        ) from None
    except (Exception, SystemExit) as error:  # what the user's code raises is told as theirs
        raise DescriptionError(
            f"fails: {failure(error, path)}",
            where=str(path),
            cure="run it alone, as `python FILE.py`, to see the whole traceback",
        ) from None
    if not callable(found):
        raise DescriptionError(
            f"defines no function `{FUNCTION}`",
            where=str(path),
            cure=f"write `def {FUNCTION}(z):` that returns a deltaid.MechanismParts",
        )
    _named.clear()
    _named[digest] = NamedFile(str(path), found)
    return digest


def with_named_file(own: OwnMechanism, where: str) -> OwnMechanism:
    """The same with the checksum of the file that the user has named.

    Raises:
        DescriptionError: no file has been named, or the description belongs to another one.
    """
    cure = "name it: deltaid --mechanism FILE.py COMMAND …, or deltaid.use_mechanism('FILE.py')"
    if not _named:
        raise DescriptionError(
            "has a mechanism of its own, whose geometry is in a Python file", where=where, cure=cure
        )
    digest = next(iter(_named))
    if own.sha256 not in (None, digest):
        raise DescriptionError(
            f"belongs to a Python file with SHA-256 {str(own.sha256)[:12]}…, but the one that was "
            f"named has {digest[:12]}…",
            where=where,
            cure="name the file that it was made with, or take mechanism.sha256 out of it",
        )
    return own.changed(sha256=digest)


def named_file(own: OwnMechanism) -> NamedFile:
    """The file of a mechanism, with its function.

    Raises:
        DescriptionError: no file has been named, or another one.
    """
    if own.sha256 is None or own.sha256 not in _named:
        raise DescriptionError(
            "the Python file of this mechanism has not been named",
            where="mechanism",
            cure="call deltaid.use_mechanism('FILE.py') before, or use deltaid --mechanism FILE.py",
        )
    return _named[own.sha256]


def failure(error: BaseException, path: str | Path = "") -> str:
    """An exception of the user's code in one line: line number, kind and message."""
    line, trace = "", error.__traceback__
    while trace is not None:
        if not path or trace.tb_frame.f_code.co_filename == str(path):
            line = f"line {trace.tb_lineno}, "
        trace = trace.tb_next
    text = str(error).strip().split("\n", 1)[0][:200]
    return f"{line}{type(error).__name__}: {text}"
