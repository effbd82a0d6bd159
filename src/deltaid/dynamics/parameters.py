"""The parameter vector p = [bodies, friction, springs, rotors], whose entries are the columns of
the regressor, and the parameters of a robot or model."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, model_validator

from deltaid.dynamics.joint_columns import joint_columns
from deltaid.errors import DescriptionError
from deltaid.robot.body import Entry, ExplicitInertia, Prior, reduced_prior
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES, INERTIA_UNITS, POSITIVE_NAMES, consistency
from deltaid.robot.load import (
    ModelFile,
    RobotLike,
    catalogue,
    holds_a_model,
    load_robot,
    parse,
    read_text,
)
from deltaid.robot.parameter import ADDED, PRIOR_SPREAD, ParameterKind, PriorParameter


def _places(kind: ParameterKind, symbol: str | None = None) -> "cached_property[slice]":
    """Slice of a layout's coefficients of a kind, or of one of its symbols."""

    def places(layout: "ParameterLayout") -> slice:
        numbers = [
            k
            for k, parameter in enumerate(layout.parameters)
            if parameter.kind == kind and symbol in (None, parameter.symbol)
        ]
        if numbers:
            return slice(numbers[0], numbers[-1] + 1)
        order = ("inertia", "friction", "spring", "rotor")
        before = order[: order.index(kind)]
        end = sum(parameter.kind in before for parameter in layout.parameters)
        return slice(end, end)

    return cached_property(places)


@dataclass(frozen=True)
class ParameterLayout:
    """Names and places of the entries of p (Sec. III B, V C).

    Attributes:
        parameters: one for each entry of p: ten for each body, then the coefficients of joints
            (friction terms by kind and joint, springs, rotor inertias), then those that a fit adds.
        bodies: body names; body b has the ten entries from 10 b on.
        friction, viscous, coulomb, spring, rotor: slices of the coefficients of these kinds.
    """

    parameters: tuple[PriorParameter, ...]
    bodies: tuple[str, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names: 'U.m', 'U.mcx', …, 'viscous.drive1', …, 'coulomb.slide', 'rotor.drive4'."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the entries."""
        return tuple(parameter.unit for parameter in self.parameters)

    def body(self, name: str) -> slice:
        """Slice of the entries of one body."""
        start = 10 * self.bodies.index(name)
        return slice(start, start + 10)

    def named(self, values: Float[np.ndarray, " parameters"]) -> dict[str, float]:
        """Values of the entries, or changes of them, by name."""
        return dict(zip(self.names, values.tolist(), strict=True))

    def require_finite(self, p: Float[np.ndarray, " parameters"]) -> None:
        """Refuse parameters that are not all finite.

        Raises:
            DescriptionError: names the first other one.
        """
        if math.isfinite(np.vdot(p, p)):
            return
        for k in np.flatnonzero(~np.isfinite(p))[:1]:
            raise DescriptionError(
                f"is {p[k]:g}, but {self.names[k]} must be a finite number",
                where=f"p[{k}]",
                cure="take p of a model, or of prior_parameters",
            )

    def require_entries(self, written: Sequence[tuple[str, str]]) -> None:
        """Refuse names and units of a model file that are not those of the parameters.

        Raises:
            ValueError: names the first other one.
        """
        if tuple(name for name, _ in written) != self.names:
            raise ValueError("parameters are not those of the robot, in its order")
        self.require_units("parameters", written)

    def require_units(self, key: str, written: Sequence[tuple[str, str]]) -> None:
        """Refuse a unit of a model file's entry that is not that of the parameter it names.

        Raises:
            ValueError: names the first other one.
        """
        units = dict(zip(self.names, self.units, strict=True))
        for k, (name, unit) in enumerate(written):
            if unit != units.get(name, unit):
                raise ValueError(f"{key}.{k}.unit is {unit}, but {name} is in {units[name]}")

    @cached_property
    def added(self) -> int:
        """Number of entries that a fit adds at the end and that are no parameters of the robot."""
        return sum(parameter.kind in ADDED for parameter in self.parameters)

    @property
    def coefficients(self) -> slice:
        """Slice of the coefficients of joints."""
        return slice(10 * len(self.bodies), len(self.parameters) - self.added)

    friction = _places("friction")  # all terms, p_f
    viscous = _places("friction", "viscous")  # one for each joint with friction
    coulomb = _places("friction", "coulomb")
    spring = _places("spring")  # one for each spring
    rotor = _places("rotor")  # one for each drive with a rotor

    @property
    def signed(self) -> dict[int, float]:
        """Indices of coefficients that may be negative (offsets), with a typical size of each."""
        first = self.coefficients.start
        pairs = enumerate(self.parameters[first:], start=first)
        return {k: parameter.scale for k, parameter in pairs if parameter.signed}


def parameter_layout(robot: RobotDescription) -> ParameterLayout:
    """The layout of p for a described robot.

    Raises:
        DescriptionError: two parameters have the same name.
    """
    bodies, entries = robot.body_names, list[PriorParameter]()
    for name in bodies:
        body = robot.bodies[name]
        entries += _of_body(name, body.prior, body.free)  # pyright: ignore[reportArgumentType]
    parameters = (*entries, *(column.parameter for column in joint_columns(robot)))
    layout = ParameterLayout(parameters, bodies)
    if len(set(layout.names)) < len(layout.names):
        twice = next(name for k, name in enumerate(layout.names) if name in layout.names[:k])
        raise DescriptionError(
            f"two parameters would be called '{twice}'",
            where=robot.name,
            cure="give the body or the joint behind it another name",
        )
    return layout


@lru_cache(maxsize=256)  # descriptions that differ in friction share their bodies
def _of_body(name: str, given: Prior, free: tuple[Entry, ...]) -> tuple[PriorParameter, ...]:
    """The ten parameters of a body; a zero entry has the scale m ℓ or m ℓ² with ℓ² = tr Σ / m."""
    prior = reduced_prior(given, free)
    scale = inertia_scale(prior)
    return tuple(
        PriorParameter("inertia", name, symbol, unit, 0.0 if symbol in POSITIVE_NAMES else -np.inf,
                  np.inf, float(prior[k]), float(scale[k]))
        for k, (symbol, unit) in enumerate(zip(INERTIA_NAMES, INERTIA_UNITS, strict=True))
    )  # fmt: skip


def stated_spreads(robot: RobotDescription) -> dict[str, float]:
    """Prior standard deviations that the description states, by names of entries of p."""
    spreads = dict[str, float]()
    for name in robot.body_names:
        own = robot.bodies[name].spread
        if isinstance(own, dict):
            spreads |= {f"{name}.{symbol}": spread for symbol, spread in own.items()}
        elif own is not None:
            spreads |= {f"{name}.{symbol}": own for symbol in INERTIA_NAMES}
    return spreads


def prior_deviations(robot: RobotDescription) -> Float[np.ndarray, " parameters"]:
    """Prior standard deviations of p, stated or usual."""
    stated, parameters = stated_spreads(robot), parameter_layout(robot).parameters
    return np.array([stated.get(entry.name, PRIOR_SPREAD) * entry.scale for entry in parameters])


def inertia_scale(p: Float[np.ndarray, " 10"]) -> Float[np.ndarray, " 10"]:
    """|p| of one body, with m ℓ in place of zero first moments and m ℓ² of zero inertias."""
    return np.where(p != 0, np.abs(p), inertia_size(p))


def inertia_size(p: Float[np.ndarray, " 10"]) -> Float[np.ndarray, " 10"]:
    """m, m ℓ for first moments and m ℓ² for inertias of one body, with ℓ its radius of gyration
    about the link frame, ℓ² = tr Σ / m."""
    m, second_moments = p[0], 0.5 * p[4:7].sum()
    length = np.sqrt(second_moments / m)
    return np.array([m, *[m * length] * 3, *[m * length**2] * 6])


def prior_parameters(robot: RobotLike) -> Float[np.ndarray, " parameters"]:
    """p_reg: the description's prior, reduced to its bodies' `free` entries."""
    layout = parameter_layout(load_robot(robot))
    return np.array([parameter.prior for parameter in layout.parameters])


def least_margin(layout: ParameterLayout, p: Float[np.ndarray, " parameters"]) -> tuple[str, float]:
    """Name of the body or coefficient closest to inconsistency, and its margin (positive if
    consistent)."""
    margins = {body: float(consistency(p[layout.body(body)])) for body in layout.bodies}
    for parameter, value in zip(
        layout.parameters[layout.coefficients], p[layout.coefficients], strict=True
    ):
        if not parameter.signed:
            margins[parameter.name] = parameter.margin(float(value))
    worst = min(margins, key=lambda name: margins[name])
    return worst, margins[worst]


def with_prior(
    robot: RobotDescription, p: Float[np.ndarray, " parameters"], **changes: object
) -> RobotDescription:
    """The same robot with p as its prior, and other changed keys.

    Constant offsets of friction are dropped: their prior is zero in any description.

    Raises:
        DescriptionError: the parameters are not physically possible.
    """
    layout, data = parameter_layout(robot), robot.model_dump()
    for name in layout.bodies:
        data["bodies"][name]["prior"] = ExplicitInertia.from_parameters(
            p[layout.body(name)]
        ).model_dump()
    for column, value in zip(joint_columns(robot), p[layout.coefficients].tolist(), strict=True):
        column.describe(data, value)
    return RobotDescription.model_validate(data | changes)


Parameters = Float[np.ndarray, " parameters"]


class _Value(BaseModel):
    """A parameter of a model file, reduced to its value."""

    name: str
    unit: str
    value: float


class ValuesFile(ModelFile):
    """A model file, reduced to its robot and its parameters."""

    parameters: tuple[_Value, ...]

    @model_validator(mode="after")
    def _check(self) -> "ValuesFile":
        parameter_layout(self.robot).require_entries(
            [(value.name, value.unit) for value in self.parameters]
        )
        return self


def known_parameters(robot: RobotLike) -> Float[np.ndarray, " parameters"] | None:
    """Parameters of a model; None for a robot, which has only a prior.

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
    values = parse(text, ValuesFile, where=str(robot))
    return np.array([parameter.value for parameter in values.parameters])
