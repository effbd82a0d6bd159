"""Names, units and prior values of the parameter vector p, the columns of the regressor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import INERTIA_NAMES, INERTIA_UNITS


@dataclass(frozen=True)
class ParameterLayout:
    """Where each parameter stands in p = [p_I, p_v, p_c, rotor inertias] (Sec. III B, V C).

    Attributes:
        names: 'U.m', 'U.mcx', …, 'viscous.drive1', …, 'coulomb.slide', 'rotor.drive4'.
        units: the unit of each.
        bodies: body names; body b has the ten columns from 10 b on.
        viscous, coulomb, rotor: columns of the other groups.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    bodies: tuple[str, ...]
    viscous: slice
    coulomb: slice
    rotor: slice

    def body(self, name: str) -> slice:
        """Columns of one body."""
        start = 10 * self.bodies.index(name)
        return slice(start, start + 10)


def parameter_layout(robot: RobotDescription) -> ParameterLayout:
    """The layout of p for a described robot."""
    joints, rotors, bodies = robot.friction_joints, robot.rotor_drives, robot.body_names
    names = [f"{body}.{entry}" for body in bodies for entry in INERTIA_NAMES]
    names += [f"viscous.{j}" for j in joints] + [f"coulomb.{j}" for j in joints]
    names += [f"rotor.{d}" for d in rotors]
    units = list(INERTIA_UNITS) * len(bodies)
    units += ["N s/m" if j == "slide" else "N m s/rad" for j in joints]
    units += ["N" if j == "slide" else "N m" for j in joints]
    units += ["kg m²"] * len(rotors)
    n, f = 10 * len(bodies), len(joints)
    return ParameterLayout(
        names=tuple(names),
        units=tuple(units),
        bodies=bodies,
        viscous=slice(n, n + f),
        coulomb=slice(n + f, n + 2 * f),
        rotor=slice(n + 2 * f, n + 2 * f + len(rotors)),
    )


def prior_parameters(robot: RobotDescription) -> Float[np.ndarray, " parameters"]:
    """p_reg: the description's prior, reduced as its bodies' `free` entries say."""
    parts = [robot.bodies[name].reduced_prior() for name in robot.body_names]
    parts.append(np.array([robot.friction[j].viscous for j in robot.friction_joints]))
    parts.append(np.array([robot.friction[j].coulomb for j in robot.friction_joints]))
    parts.append(np.array([robot.rotor_inertia[d] for d in robot.rotor_drives]))
    return np.concatenate(parts)
