"""From the columns that were gathered to those of a fit: a linear map.

A column of a fit is a combination of gathered ones, Y = G T: of a rigid body by the mechanism alone
(base parameters of a generic motion), of a friction term by its values at the knots of a spline.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout
from deltaid.estimation.additions import Addition
from deltaid.factors.columns import GatheredColumns
from deltaid.factors.speed_columns import Shape, SpeedColumns
from deltaid.identification.friction_curves import LawConstants
from deltaid.robot.friction_terms import FrictionTerm

# Friction at rest is that of hardly moving: its side of the step is told by the direction.
_CREEP = 1e-12

# What the columns of a fit are in gathered ones.
Map = Float[np.ndarray, "kept columns"]


def map_to(columns: GatheredColumns, dynamics: Dynamics, additions: Sequence[Addition] = ()) -> Map:
    """T for a robot with any friction law, and for additions behind its columns.

    Args:
        columns: what was gathered.
        dynamics: of the same mechanism.
        additions: loads that were gathered, and constants of the robot's laws.
    """
    place = {name: i for i, name in enumerate(columns.kept_names)}
    parts = [_of_robot(columns, dynamics, place)]
    parts += [_of_addition(one, columns, place) for one in additions]
    return np.hstack(parts)


def _of_robot(
    columns: GatheredColumns, dynamics: Dynamics, place: dict[str, int]
) -> Float[np.ndarray, "kept own"]:
    """The columns of the robot's own parameters."""
    layout, T = dynamics.layout, np.zeros((len(place), len(dynamics.layout.names)))
    for group in columns.base.groups:
        plain = columns.dynamics.layout
        row = place.get(plain.names[group.representative])
        if row is None:
            continue  # friction, which has columns of its own
        for member, share in {group.representative: 1.0, **group.members}.items():
            T[row, _at(layout, plain.names[member])] = share
    first = layout.friction.start
    for k, term in enumerate(dynamics.robot.friction_terms):
        T[:, first + k] = _of_term(columns, term, place)
    return T


def _at(layout: ParameterLayout, name: str) -> int:
    return layout.names.index(name)


def _of_term(
    columns: GatheredColumns, term: FrictionTerm, place: dict[str, int]
) -> Float[np.ndarray, " kept"]:
    """A friction term for a coefficient of one."""
    found = np.zeros(len(place))
    if term.of_load:
        found[place[f"carried.{term.joint}"]] = 1.0
        return found

    def shape(v: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return term.values(direction * np.maximum(v, _CREEP))

    return _along_speed(columns, term.joint, shape, found, place)


def _along_speed(
    columns: GatheredColumns,
    joint: str,
    shape: Shape,
    found: Float[np.ndarray, " kept"],
    place: dict[str, int],
) -> Float[np.ndarray, " kept"]:
    """With a joint's friction over speed put in."""
    one = _speed_columns(columns, joint)
    for parameter, value in zip(one.parameters, one.of(shape), strict=True):
        found[place[parameter.name]] = value
    return found


def _speed_columns(columns: GatheredColumns, joint: str) -> SpeedColumns:
    return next(
        one for one in columns.additions if isinstance(one, SpeedColumns) and one.joint == joint
    )


def _of_addition(
    one: Addition, columns: GatheredColumns, place: dict[str, int]
) -> Float[np.ndarray, "kept own"]:
    """The columns of an addition; those that no torque shows are zero."""
    T = np.zeros((len(place), len(one.parameters)))
    if isinstance(one, LawConstants):
        for k, (term, name) in enumerate(one.constants):
            shape = partial(_slope, term, name)
            T[:, k] = _along_speed(columns, term.joint, shape, np.zeros(len(place)), place)
        return T
    for k, parameter in enumerate(one.parameters):
        if parameter.name in place:
            T[place[parameter.name], k] = 1.0
    return T


def _slope(term: FrictionTerm, name: str, v: np.ndarray, direction: np.ndarray) -> np.ndarray:
    return term.size * term.slopes(direction * np.maximum(v, _CREEP))[name]
