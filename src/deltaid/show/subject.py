"""What is to be shown: a robot at its prior, or an identified model."""

import re
from dataclasses import dataclass
from pathlib import Path

from deltaid.dynamics.dynamics import Parameters, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.model import IdentifiedModel
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.show.rest import AtRest

# A key that every model file has at its left edge, and no robot file.
_OF_MODELS = re.compile(rb"^[\"']?parameters[\"']?\s*:", re.MULTILINE)
_READ = 1 << 20


@dataclass(frozen=True)
class Subject:
    """A robot, its parameters, and a sentence about where they come from."""

    robot: RobotDescription
    p: Parameters
    origin: str

    def at_rest(self) -> AtRest:
        """The robot standing still, compiled.

        Raises:
            KinematicsError: it cannot stand in the middle of its own workspace.
        """
        return AtRest(compiled(self.robot), self.p)


def load_subject(name: str) -> Subject:
    """A catalogue robot by name, a robot file or a model file by path.

    Raises:
        DescriptionError: no such robot or file, or the file is neither.
    """
    if _holds_a_model(Path(name)):
        model = IdentifiedModel.load(name)
        return Subject(model.robot, model.p, "Robot at rest, with its identified parameters")
    robot = load_robot(name)
    return Subject(robot, prior_parameters(robot), "Robot at rest, with its prior parameters")


def _holds_a_model(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return bool(_OF_MODELS.search(file.read(_READ)))
    except (OSError, ValueError):  # a catalogue name, or what `load_robot` complains about
        return False
