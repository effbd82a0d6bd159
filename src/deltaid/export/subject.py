"""What is exported: a robot, its parameters, and where they come from."""

from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters, compiled
from deltaid.errors import DeltaidError
from deltaid.export.inertia import why_not_physical
from deltaid.robot.description import RobotDescription


@dataclass(frozen=True, eq=False)
class ExportSubject:
    """A robot with parameters that can exist.

    Attributes:
        robot: its description.
        p: parameters in the order of the layout.
        source: name of the file or catalogue robot that they come from.

    Raises:
        DeltaidError: the parameters are not those of the robot, or a body of them cannot exist.
    """

    robot: RobotDescription
    p: Parameters
    source: str

    def __post_init__(self) -> None:
        layout = self.dynamics.layout
        if self.p.shape != (len(layout.names),):
            raise DeltaidError(
                f"has {self.p.size} parameters, but the robot has {len(layout.names)}",
                where=self.source,
            )
        for name in layout.bodies:
            reason = why_not_physical(self.p[layout.body(name)])
            if reason:
                raise DeltaidError(
                    f"body {name} cannot be exported: {reason}",
                    where=self.source,
                    cure="identify the model again; its result is always consistent",
                )

    @cached_property
    def dynamics(self) -> Dynamics:
        """The robot's dynamics, compiled where it is needed."""
        return compiled(self.robot)

    def body(self, name: str) -> Float[np.ndarray, " 10"]:
        """The ten parameters of one body, about its link frame."""
        return self.p[self.dynamics.layout.body(name)]

    def value(self, name: str) -> float:
        """One parameter, such as 'viscous.drive1'; zero where the robot has none of that name."""
        names = self.dynamics.layout.names
        return float(self.p[names.index(name)]) if name in names else 0.0

    def without_friction(self) -> "ExportSubject":
        """The same robot with all friction coefficients zero."""
        p = self.p.copy()
        p[self.dynamics.layout.friction] = 0.0
        return replace(self, p=p)

    @property
    def home(self) -> Float[np.ndarray, " dof"]:
        """A pose in the middle of the workspace, z."""
        return self.dynamics.kinematics.home

    @property
    def provenance(self) -> str:
        """One line for the head of a file."""
        title = _printable(self.robot.title) or self.name
        return f"{title}, from {_printable(self.source)} by deltaid {version('deltaid')}"

    @property
    def name(self) -> str:
        """The robot's name, for other programs' files."""
        return _printable(self.robot.name) or "robot"


def _printable(text: str) -> str:
    """Text on one line without control characters, which no file format takes."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
