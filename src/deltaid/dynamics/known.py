"""Parameters that come with what stands for a robot: those of a model, by value or file."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel

from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.errors import DescriptionError
from deltaid.kernel.real import real_numbers
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, catalogue, holds_a_model, parse, read_text

Parameters = Float[np.ndarray, " parameters"]
_Self = TypeVar("_Self", bound="WithParameters")


class WithParameters:
    """What computes with parameters that are given, or with those it was made with.

    Attributes:
        robot: the description.
        layout: names and places of its parameters.
    """

    # Beside what instances of one robot share (`with_parameters`): their `__dict__`, with all
    # compiled kernels.
    __slots__ = ("_p",)
    _p: Parameters | None
    robot: RobotDescription
    layout: ParameterLayout

    def with_parameters(self: _Self, p: Parameters) -> _Self:
        """The same with other parameters to begin with; compiled kernels are shared."""
        other = object.__new__(type(self))
        other.__dict__ = self.__dict__
        other._p = p
        return other

    @property
    def p(self) -> Parameters:
        """The parameters that hold where none are given."""
        return prior_parameters(self.robot) if self._p is None else self._p

    def _parameters(self, p: Parameters | None) -> Parameters:
        """Those given, or its own.

        Raises:
            DescriptionError: they are not as many as the robot has.
        """
        if p is None:
            return self.p
        cure = "give one for each of layout.names, such as p of a model"
        p = real_numbers(p, "p", cure=cure, error=DescriptionError).astype(float, copy=False)
        if p.shape != (len(self.layout.names),):
            raise DescriptionError(
                f"p has shape {p.shape}, but the robot has {len(self.layout.names)} parameters",
                where=self.robot.name,
                cure=cure,
            )
        return p


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
    if isinstance(robot, Mapping):
        return None
    if not isinstance(robot, str | Path):
        known = getattr(getattr(robot, "model", robot), "p", None)
        return known if isinstance(known, np.ndarray) and known.ndim == 1 else None
    if str(robot) in catalogue() or not os.path.exists(robot):
        return None
    text = read_text(Path(robot))
    if not holds_a_model(text):
        return None
    found = parse(text, _Values, where=str(robot))
    return np.array([parameter.value for parameter in found.parameters])
