"""Parameters that come with what stands for a robot: those of a model, by value or file."""

import os
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel

from deltaid.robot.load import RobotLike, catalogue, holds_a_model, parse, read_text


class _Value(BaseModel):
    """A parameter of a model file, of which only the value is wanted."""

    value: float


class _Values(BaseModel):
    """A model file, of which only the parameters are wanted."""

    parameters: tuple[_Value, ...]


def known_parameters(robot: RobotLike) -> Float[np.ndarray, " parameters"] | None:
    """The parameters of a model; None of a robot, whose are its prior.

    Raises:
        DescriptionError: a file that holds a model does not hold its parameters as numbers.
    """
    if not isinstance(robot, str | Path):
        known = getattr(robot, "p", None)
        return known if isinstance(known, np.ndarray) and known.ndim == 1 else None
    if str(robot) in catalogue() or not os.path.exists(robot):
        return None
    text = read_text(Path(robot))
    if not holds_a_model(text):
        return None
    found = parse(text, _Values, where=str(robot))
    return np.array([one.value for one in found.parameters])
