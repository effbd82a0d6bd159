"""What a joint feels beside rigid bodies: friction, springs, rotors, each one column of Y.

A column's generalised force is its coefficient times e(ϑ, ϑ̇, ϑ̈, load) ∂ϑ/∂q with the coordinate ϑ
of its joint (eqs. (6) and (7) for viscous and Coulomb friction). A new kind of column is one class
here.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import PriorParameter

Sign = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class JointMotion:
    """One joint at one instant.

    Attributes:
        position, speed, acceleration: ϑ, ϑ̇, ϑ̈ [rad or m, and per s, per s²].
        load: torque or force that its drive's gear carries; zero in a joint without one.
        sign: of the speed, or a smooth stand-in for it.
    """

    position: ca.SX
    speed: ca.SX
    acceleration: ca.SX
    load: ca.SX
    sign: Sign = ca.sign


@dataclass(frozen=True)
class JointColumn(ABC):
    """One coefficient that acts along one joint.

    Attributes:
        joint: its name.
        parameter: the coefficient.
        inertia: ∂e/∂ϑ̈.
    """

    joint: str
    parameter: PriorParameter
    inertia: ClassVar[float] = 0.0

    @abstractmethod
    def effort(self, motion: JointMotion) -> ca.SX:
        """e: torque or force that the motion takes for a coefficient of one."""

    @abstractmethod
    def describe(self, data: dict[str, Any], value: float) -> None:
        """Put a value of the coefficient where a description has it, as keys and values."""

    def potential(self, position: ca.SX) -> ca.SX:
        """Energy that a coefficient of one stores [J]."""
        return ca.SX(0)


@dataclass(frozen=True)
class FrictionColumn(JointColumn):
    """One term of a friction law, e = h(ϑ̇)."""

    term: FrictionTerm

    def effort(self, motion: JointMotion) -> ca.SX:
        return self.term.h(motion.speed, motion.sign(motion.speed), motion.load)

    def describe(self, data: dict[str, Any], value: float) -> None:
        data["friction"][self.joint] |= self.term.in_law(value)


@dataclass(frozen=True)
class SpringColumn(JointColumn):
    """A linear spring, e = ϑ − rest."""

    rest: float

    def effort(self, motion: JointMotion) -> ca.SX:
        return motion.position - self.rest

    def describe(self, data: dict[str, Any], value: float) -> None:
        data["springs"][self.joint]["stiffness"] = value

    def potential(self, position: ca.SX) -> ca.SX:
        return 0.5 * (position - self.rest) ** 2


@dataclass(frozen=True)
class RotorColumn(JointColumn):
    """Inertia of motor and gear, reduced to their drive, e = ϑ̈."""

    inertia: ClassVar[float] = 1.0

    def effort(self, motion: JointMotion) -> ca.SX:
        return motion.acceleration

    def describe(self, data: dict[str, Any], value: float) -> None:
        data["rotor_inertia"][self.joint] = value


def joint_columns(robot: RobotDescription) -> tuple[JointColumn, ...]:
    """All of a robot's, in the order of p, where they follow the bodies."""
    return (
        *friction_columns(robot.friction_terms),
        *(_spring(robot, joint) for joint in robot.spring_joints),
        *(_rotor(robot, drive) for drive in robot.rotor_drives),
    )


def friction_columns(terms: Iterable[FrictionTerm]) -> tuple[FrictionColumn, ...]:
    """One column a term."""
    return tuple(FrictionColumn(term.joint, term.parameter, term) for term in terms)


def _spring(robot: RobotDescription, joint: str) -> SpringColumn:
    value, unit = robot.springs[joint].stiffness, robot.units(joint).stiffness
    parameter = PriorParameter("spring", joint, "spring", unit, 0.0, np.inf, value, value)
    return SpringColumn(joint, parameter, robot.spring_rest(joint))


def _rotor(robot: RobotDescription, drive: str) -> RotorColumn:
    value, unit = robot.rotor_inertia[drive], robot.units(drive).inertia
    parameter = PriorParameter("rotor", drive, "rotor", unit, 0.0, np.inf, value, value)
    return RotorColumn(drive, parameter)
