"""Joint torques besides rigid bodies: friction, springs and rotors, each one column of Y.

A column's generalised force is its coefficient times e(ϑ, ϑ̇, ϑ̈, load) ∂ϑ/∂q with the coordinate ϑ
of its joint (eqs. (6) and (7) for viscous and Coulomb friction). Each kind of column is a class of
this module.

Load-dependent friction: a gear loses a share of the torque that it carries. With the torque x that
a drive's gear carries on the link's side, the drive's torque without its motor's own friction and
rotor,

    τ = x + f(q̇) + I_r q̈ + μ sign(q̇) |x|,    x = M_l q̈ + C q̇ + g + passive joints.

Inverse dynamics evaluates this directly. Forward dynamics is given τ instead of x: losses ℓ = μ
sign(q̇) |x| change accelerations by −G ℓ, G = M⁻¹, and rotor torques by −I_r G ℓ, so that

    x = x⁰ − (1 − I_r G) ℓ

with x⁰ the solution without losses. For |μ| < 1 the solution is unique, because (1 ± μ) M_l + I_r
is positive definite for all signs.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import FrictionTerm
from deltaid.robot.parameter import ParameterKind, PriorParameter

Sign = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class JointMotion:
    """Motion of one joint at one instant.

    Attributes:
        position, speed, acceleration: ϑ, ϑ̇, ϑ̈ [rad or m, and per s, per s²].
        load: torque or force that its drive's gear carries; zero for a joint without a drive.
        sign: sign function of the speed, or a smooth approximation.
    """

    position: ca.SX
    speed: ca.SX
    acceleration: ca.SX
    load: ca.SX
    sign: Sign = ca.sign


@dataclass(frozen=True)
class JointColumn(ABC):
    """A coefficient that acts along one joint.

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
        """e: torque or force that the motion requires for a unit coefficient."""

    @abstractmethod
    def describe(self, data: dict[str, Any], value: float) -> None:
        """Set the coefficient in a description's plain data."""

    def potential(self, position: ca.SX) -> ca.SX:
        """Energy that a unit coefficient stores [J]."""
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
    """Inertia of motor and gear, reduced to the drive's coordinate, e = ϑ̈."""

    inertia: ClassVar[float] = 1.0

    def effort(self, motion: JointMotion) -> ca.SX:
        return motion.acceleration

    def describe(self, data: dict[str, Any], value: float) -> None:
        data["rotor_inertia"][self.joint] = value


def joint_columns(robot: RobotDescription) -> tuple[JointColumn, ...]:
    """All columns of a robot, in the order of p after the bodies."""
    return (
        *friction_columns(robot.friction_terms),
        *(
            SpringColumn(
                joint,
                _positive(
                    "spring", joint, robot.units(joint).stiffness, robot.springs[joint].stiffness
                ),
                robot.spring_rest(joint),
            )
            for joint in robot.spring_joints
        ),
        *(
            RotorColumn(
                drive,
                _positive("rotor", drive, robot.units(drive).inertia, robot.rotor_inertia[drive]),
            )
            for drive in robot.rotor_drives
        ),
    )


def friction_columns(terms: Iterable[FrictionTerm]) -> tuple[FrictionColumn, ...]:
    """Friction columns, one for each term."""
    return tuple(FrictionColumn(term.joint, term.parameter, term) for term in terms)


def _positive(kind: ParameterKind, joint: str, unit: str, value: float) -> PriorParameter:
    return PriorParameter(kind, joint, kind, unit, 0.0, np.inf, value, value)


def with_load_friction(
    robot: RobotDescription, torque: ca.SX, speed: ca.SX, acceleration: ca.SX, p: ca.SX
) -> ca.SX:
    """τ of a motion, from the torque without load-dependent friction.

    Args:
        torque: τ without load-dependent friction.
        speed: q̇, or the direction in which friction acts.
        acceleration: q̈.
        p: the parameters.
    """
    total, x = ca.SX(torque), carried(robot, torque, speed, acceleration, p)
    for i, share in load_shares(robot, speed, p):
        total[i] += share * ca.fabs(x[i])
    return total


def carried(
    robot: RobotDescription, torque: ca.SX, speed: ca.SX, acceleration: ca.SX, p: ca.SX
) -> ca.SX:
    """x: torques without the drives' friction and rotors; `torque` excludes load-dependent
    friction."""
    x, none = ca.SX(torque), ca.SX(0)
    for k, i, column in columns_of_drives(robot):
        if column.parameter.kind != "spring" and column.parameter.symbol != "load":
            x[i] -= p[k] * column.effort(JointMotion(none, speed[i], acceleration[i], none))
    return x


def rotor_inertia(robot: RobotDescription, p: ca.SX) -> ca.SX:
    """I_r of every drive."""
    inertia = ca.SX.zeros(len(robot.drives))
    for k, i, column in columns_of_drives(robot):
        inertia[i] += column.inertia * p[k]
    return inertia


def load_shares(robot: RobotDescription, speed: ca.SX, p: ca.SX) -> Iterator[tuple[int, ca.SX]]:
    """Drives with load-dependent friction, and μ sign(q̇) of each."""
    for k, i, column in columns_of_drives(robot):
        if column.parameter.symbol == "load":
            yield i, p[k] * ca.sign(speed[i])


def losses(robot: RobotDescription, x: ca.SX, response: ca.SX, speed: ca.SX, p: ca.SX) -> ca.SX:
    """ℓ of the drives in `RobotDescription.load_drives`, for forward dynamics.

    Args:
        x: x⁰ of all drives.
        response: G, accelerations of all drives for unit torques at the drives with losses.
        speed: q̇.
        p: the parameters.
    """
    pairs, inertia = list(load_shares(robot, speed, p)), rotor_inertia(robot, p)
    at, share = [i for i, _ in pairs], ca.vertcat(*(share for _, share in pairs))
    response_at = ca.SX.eye(len(at)) - ca.diag(inertia[at]) @ response[at, :]
    start = load = x[at]
    # Newton steps on the signs of the loads: one for each sign, and a last one, which is exact.
    for _ in range(1 + len(at)):
        # No ca.sign: exports may replace the sign of a speed by a smooth function.
        side = 1 - 2 * (load < 0)
        load = ca.inv_minor(ca.SX.eye(len(at)) + response_at @ ca.diag(share * side)) @ start
    return share * ca.fabs(load)


def columns_of_drives(robot: RobotDescription) -> Iterator[tuple[int, int, JointColumn]]:
    """Coefficients along drives: index in p, index of the drive, column."""
    first = 10 * len(robot.body_names)
    for k, column in enumerate(joint_columns(robot), start=first):
        if column.joint in robot.drives:
            yield k, robot.drives.index(column.joint), column
