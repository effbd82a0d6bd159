"""The columns that a recording is gathered with, for any later fit of its robot.

- Rigid bodies, rotors, springs: the representatives of the base parameters of a generic motion.
  All their other columns are combinations of these by the mechanism alone.
- Friction: splines over speed (`speed_columns`), and what gears carry.
- What loads take while they are held.
- Nuisance columns of this recording: residual lag of each drive, friction that changes along it.

A column of a fit is a combination of gathered ones, Y = G T: of a rigid body by the mechanism alone
(base parameters of a generic motion), of a friction term by its values at the knots of a spline.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.additions import Addition, Extended, extended
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import active_columns
from deltaid.factors.speed_columns import CarriedColumns, SpeedColumns
from deltaid.identification.friction_curves import LawConstants
from deltaid.identification.generic_motion import random_motion_base
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import FrictionTerm

# Reference speeds of joints whose limits the description does not give [rad/s, m/s].
_TURNING, _SLIDING = 20.0, 5.0


def plain(robot: RobotDescription) -> RobotDescription:
    """The robot with viscous and Coulomb friction only, in the joints that have friction."""
    laws = {
        joint: Friction(viscous=law.viscous, coulomb=law.coulomb)
        for joint, law in robot.friction.items()
    }
    return robot.changed(friction=laws, measured=(), sensors={})


@lru_cache(maxsize=8)
def _generic_base(description: str) -> BaseParameters:
    return random_motion_base(compiled(RobotDescription.model_validate_json(description)))


def _reference_speed(robot: RobotDescription, joint: str) -> float:
    """The speed up to which a joint's friction is followed closely [rad/s or m/s]."""
    limits = robot.drive_limits.get(joint)
    if robot.units(joint).coordinate == "m":
        return float((limits and limits.speed) or _SLIDING)
    degrees = limits and limits.speed_deg_s
    return float(np.deg2rad(degrees)) if degrees else _TURNING


@dataclass(frozen=True, eq=False)
class GatheredColumns:
    """The columns of one robot, with additional ones.

    Attributes:
        dynamics: of the robot with plain friction.
        additions: speed columns, then carried load, then all others.
    """

    dynamics: Dynamics
    additions: tuple[Addition, ...]

    @classmethod
    def of(
        cls,
        robot: RobotDescription,
        p: Float[np.ndarray, " parameters"],
        others: Sequence[Addition] = (),
    ) -> "GatheredColumns":
        """Columns of a robot.

        Args:
            p: of the plain robot, for the load that gears carry.
            others: additional columns.
        """
        dynamics = compiled(plain(robot))
        speeds = (
            SpeedColumns(dynamics, joint, _reference_speed(dynamics.robot, joint))
            for joint in dynamics.robot.friction_joints
        )
        carried = CarriedColumns(dynamics, p)
        return cls(dynamics, (*speeds, carried, *(addition.on(dynamics) for addition in others)))

    @cached_property
    def regressor(self) -> Dynamics | Extended:
        """The plain robot's columns, then the additions."""
        return extended(self.dynamics, self.additions)

    @property
    def base(self) -> BaseParameters:
        """What any generic motion shows of the plain robot."""
        return _generic_base(self.dynamics.robot.model_dump_json())

    @cached_property
    def kept(self) -> Int[np.ndarray, " kept"]:
        """Places of the columns that go into a file among those of the regressor."""
        count = len(self.dynamics.layout.names)
        friction = range(count)[self.dynamics.layout.friction]
        rigid = {group.representative for group in self.base.groups} - {*friction}
        return np.intersect1d(
            [*rigid, *range(count, len(self.names))], active_columns(self.regressor)
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all columns of the regressor."""
        added = (parameter.name for addition in self.additions for parameter in addition.parameters)
        return (*self.dynamics.layout.names, *added)

    @cached_property
    def place(self) -> dict[str, int]:
        """Place of each name among those that go into a file, in their order."""
        return {self.names[column]: k for k, column in enumerate(self.kept)}


def map_to(
    columns: GatheredColumns, dynamics: Dynamics, additions: Sequence[Addition] = ()
) -> Float[np.ndarray, "kept columns"]:
    """T for a robot with any friction law, and for additions behind its columns.

    Args:
        columns: what was gathered.
        dynamics: of the same mechanism.
        additions: loads that were gathered, and constants of the robot's laws.
    """
    plain_names, place = columns.dynamics.layout.names, columns.place
    shares: dict[str, dict[str, float]] = {}
    for group in columns.base.groups:
        representative = plain_names[group.representative]
        for member, share in {group.representative: 1.0, **group.members}.items():
            shares.setdefault(plain_names[member], {})[representative] = share
    for term in dynamics.robot.friction_terms:
        shares[term.name] = _friction(columns, term, term.values)
    every = [shares.get(name, {}) for name in dynamics.layout.names]
    for extra in additions:
        if isinstance(extra, LawConstants):
            slopes = ((term, partial(_slope, term, constant)) for term, constant in extra.constants)
            every += [_friction(columns, term, slope) for term, slope in slopes]
        else:
            every += [{parameter.name: 1.0} for parameter in extra.parameters]
    T = np.zeros((len(place), len(every)))
    for k, combination in enumerate(every):
        for name, share in combination.items():
            if name in place:  # others have no effect on torques
                T[place[name], k] = share
    return T


def _friction(
    columns: GatheredColumns, term: FrictionTerm, h: Callable[[np.ndarray], np.ndarray]
) -> dict[str, float]:
    """Friction h(v) in a term's joint, or its share of the load, in gathered columns."""
    if term.of_load:
        return {f"carried.{term.joint}": 1.0}
    speeds = (splines for splines in columns.additions if isinstance(splines, SpeedColumns))
    splines = next(splines for splines in speeds if splines.name == term.joint)
    names = (parameter.name for parameter in splines.parameters)
    return dict(zip(names, splines.following(h).tolist(), strict=True))


def _slope(term: FrictionTerm, constant: str, v: np.ndarray) -> np.ndarray:
    return term.size * term.slopes(v)[constant]
