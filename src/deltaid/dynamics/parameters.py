"""Names, units and prior values of the parameter vector p, the columns of the regressor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES, INERTIA_UNITS


@dataclass(frozen=True)
class ParameterLayout:
    """Where each parameter stands in p = [p_I, p_f, springs, rotor inertias] (Sec. III B, V C).

    Attributes:
        names: 'U.m', 'U.mcx', …, 'viscous.drive1', …, 'coulomb.slide', 'rotor.drive4'.
        units: the unit of each.
        bodies: body names; body b has the ten columns from 10 b on.
        friction: columns of all friction terms p_f, first `viscous`, then `coulomb`, one a joint
            each, then the terms of richer laws.
        spring: columns of the spring stiffnesses.
        rotor: columns of the rotor inertias.
        signed: columns whose parameter may be negative, with a typical size of each: offsets.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    bodies: tuple[str, ...]
    friction: slice
    viscous: slice
    coulomb: slice
    spring: slice
    rotor: slice
    signed: dict[int, float]

    def body(self, name: str) -> slice:
        """Columns of one body."""
        start = 10 * self.bodies.index(name)
        return slice(start, start + 10)


def parameter_layout(robot: RobotDescription) -> ParameterLayout:
    """The layout of p for a described robot."""
    rotors, springs = robot.rotor_drives, robot.spring_joints
    bodies, terms = robot.body_names, robot.friction_terms
    names = [f"{body}.{entry}" for body in bodies for entry in INERTIA_NAMES]
    names += [term.name for term in terms]
    names += [f"spring.{j}" for j in springs]
    names += [f"rotor.{d}" for d in rotors]
    units = list(INERTIA_UNITS) * len(bodies)
    units += [term.unit for term in terms]
    units += [robot.units(j).stiffness for j in springs]
    units += [robot.units(d).inertia for d in rotors]
    n, joints = 10 * len(bodies), len(robot.friction_joints)
    springs_at = n + len(terms)
    end = springs_at + len(springs)
    return ParameterLayout(
        names=tuple(names),
        units=tuple(units),
        bodies=bodies,
        friction=slice(n, springs_at),
        viscous=slice(n, n + joints),
        coulomb=slice(n + joints, n + 2 * joints),
        spring=slice(springs_at, end),
        rotor=slice(end, end + len(rotors)),
        signed={n + i: term.size for i, term in enumerate(terms) if term.signed},
    )


def prior_parameters(robot: RobotDescription) -> Float[np.ndarray, " parameters"]:
    """p_reg: the description's prior, reduced as its bodies' `free` entries say."""
    parts = [robot.bodies[name].reduced_prior() for name in robot.body_names]
    parts.append(np.array([term.prior for term in robot.friction_terms]))
    parts.append(np.array([robot.springs[j].stiffness for j in robot.spring_joints]))
    parts.append(np.array([robot.rotor_inertia[d] for d in robot.rotor_drives]))
    return np.concatenate(parts)
