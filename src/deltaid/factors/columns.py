"""The columns that a recording is gathered with, whatever robot is fitted to it later.

- Rigid bodies, rotors, springs: the representatives of the base parameters of a generic motion.
  All their other columns are combinations of these by the mechanism alone.
- Friction: splines over speed (`speed_columns`), and what gears carry.
- What loads take while they are held.
- What is of this recording alone: a lag of each drive beside what has been put right, friction that
  changes along it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.additions import Addition, Extended, extended
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.information import active_columns
from deltaid.factors.carried_column import CarriedColumns
from deltaid.factors.speed_columns import SpeedColumns
from deltaid.identification.generic_motion import random_motion_base
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction

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


def reference_speed(robot: RobotDescription, joint: str) -> float:
    """The speed up to which a joint's friction is followed closely [rad/s or m/s]."""
    limits = robot.drive_limits.get(joint)
    sliding = robot.units(joint).coordinate == "m"
    given = None
    if limits is not None:
        degrees = limits.speed_deg_s
        given = limits.speed if sliding else None if degrees is None else np.deg2rad(degrees)
    return float(given or (_SLIDING if sliding else _TURNING))


@dataclass(frozen=True, eq=False)
class GatheredColumns:
    """The columns of one robot, with some beside it.

    Attributes:
        dynamics: of the robot with plain friction.
        additions: speed columns, then what is carried, then all others.
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
            p: of the plain robot, by which it is known what gears carry.
            others: additions beside speed and load.
        """
        dynamics = compiled(plain(robot))
        speeds = speed_columns(dynamics)
        carried = CarriedColumns(dynamics, p)
        return cls(dynamics, (*speeds, carried, *(one.on(dynamics) for one in others)))

    @cached_property
    def regressor(self) -> Dynamics | Extended:
        """All of them behind those of the plain robot."""
        return extended(self.dynamics, self.additions)

    @cached_property
    def base(self) -> BaseParameters:
        """What any generic motion tells of the plain robot."""
        return _generic_base(self.dynamics.robot.model_dump_json())

    @cached_property
    def kept(self) -> Int[np.ndarray, " kept"]:
        """Places of the columns that go into a file among those of the regressor."""
        layout = self.dynamics.layout
        own = len(layout.names)
        friction = np.arange(own)[layout.friction]
        rigid = [
            one.representative for one in self.base.groups if one.representative not in friction
        ]
        more = range(own, own + sum(len(one.parameters) for one in self.additions))
        return np.intersect1d([*rigid, *more], active_columns(self.regressor))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all columns of the regressor."""
        more = (parameter.name for one in self.additions for parameter in one.parameters)
        return (*self.dynamics.layout.names, *more)

    @cached_property
    def kept_names(self) -> tuple[str, ...]:
        """Names of those that go into a file."""
        return tuple(self.names[k] for k in self.kept)


def speed_columns(dynamics: Dynamics) -> tuple[SpeedColumns, ...]:
    """Those of every joint with friction."""
    robot = dynamics.robot
    return tuple(
        SpeedColumns(dynamics, joint, reference_speed(robot, joint))
        for joint in robot.friction_joints
    )
