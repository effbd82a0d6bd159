"""Measured values of bodies as rows of the fit: cᵀp = v ± σ.

With the ten parameters of a body about its link frame, [m, mc, Θ], turned by R and moved by d into
the axes of the measurement,

    mass:            m
    first moment:    eᵀ(R mc + m d)
    centre:          eᵀ(R mc + m d) − v m = 0, with the deviation σ times the mass
    inertia:         eᵀΘ′e of the turned and moved body, about a point of the line

each summed over the bodies measured together. All are linear in p.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.parameters import ParameterLayout, parameter_layout, prior_parameters
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.limbs import rotation as about_axis
from deltaid.robot.measured import Measured, Placed
from deltaid.robot.part import Vector

_WORDS = {
    "mass": "mass",
    "first_moment": "first moment",
    "centre": "centre of mass",
    "inertia": "moment of inertia",
}


@dataclass(frozen=True, eq=False)
class Weighing:
    """One measured value as a row.

    Attributes:
        name: quantity and body: 'mass of S', 'centre of mass of U along x'.
        where: its key in the description.
        unit: of the value.
        coefficients: c, over the robot's parameters.
        value, std: v and σ of cᵀp; for a centre 0 and σ times the mass.
    """

    name: str
    where: str
    unit: str
    coefficients: Float[np.ndarray, " parameters"]
    value: float
    std: float

    def over(self, columns: Int[np.ndarray, " columns"]) -> Float[np.ndarray, " columns"]:
        """c at some columns of a fit, zero at those after the robot's parameters."""
        of_robot = columns < len(self.coefficients)
        return np.where(of_robot, self.coefficients[np.where(of_robot, columns, 0)], 0.0)

    def shown(self, value: float) -> str:
        """A value rounded to a tenth of the standard deviation."""
        digits = max(0, 1 - math.floor(math.log10(self.std)))
        return f"{value:.{digits}f}"


def weighings(robot: RobotDescription) -> tuple[Weighing, ...]:
    layout, prior = parameter_layout(robot), prior_parameters(robot)
    alone = [
        weighing(measured, (Placed(body=name),), layout, prior, f"bodies.{name}.measured[{k}]")
        for name in robot.body_names
        for k, measured in enumerate(robot.bodies[name].measured, start=1)
    ]
    together = [
        weighing(measured, measured.placed, layout, prior, f"measured[{k}]")
        for k, measured in enumerate(robot.measured, start=1)
    ]
    return (*alone, *together)


def weighing(
    measured: Measured,
    placed: Sequence[Placed],
    layout: ParameterLayout,
    prior: Float[np.ndarray, " parameters"],
    where: str = "measured",
) -> Weighing:
    """One measured value as a row.

    Args:
        placed: the bodies measured together.
        layout: of p.
        prior: values of p before the fit; their masses scale the deviation of a centre's row.
        where: its key in the description.
    """
    c, masses = np.zeros(len(prior)), np.zeros(len(prior))
    for part in placed:
        place = layout.body(part.body)
        R, d = rotation(part.turned_deg), np.array(part.at)
        units = [RigidBody(unit).moved(R, d) for unit in np.eye(10)]
        c[place] += part.count * np.array([_quantity(measured, unit) for unit in units])
        masses[place.start] += part.count
    value, std, axis = measured.value, measured.std, measured.axis
    if measured.quantity == "centre":
        value, std = 0.0, std * float(masses @ prior)
    bodies = " and ".join(f"{p.count} {p.body}" if p.count > 1 else p.body for p in placed)
    if axis is not None:
        direction = axis if isinstance(axis, str) else f"({', '.join(f'{x:g}' for x in axis)})"
        bodies += f" along {direction}"
    unit = {"mass": "kg", "inertia": "kg m²"}.get(measured.quantity, "kg m")
    return Weighing(f"{_WORDS[measured.quantity]} of {bodies}", where, unit, c, value, std)


def _quantity(measured: Measured, body: RigidBody) -> float:
    """The measured quantity of a body described in the axes of the measurement."""
    p, axis = body.p, measured.axis
    if axis is None:
        return float(p[0])
    e = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else np.array(axis)
    e = e / np.linalg.norm(e)
    if measured.quantity == "first_moment":
        return float(e @ p[1:4])
    if measured.quantity == "centre":
        return float(e @ p[1:4] - measured.value * p[0])
    return float(e @ body.moved(np.eye(3), -np.array(measured.about)).about_link @ e)


def rotation(turned_deg: Vector) -> Float[np.ndarray, "3 3"]:
    """R = Rz(yaw) Ry(pitch) Rx(roll) of roll, pitch and yaw in degrees."""
    roll, pitch, yaw = turned_deg
    return about_axis("z", yaw) @ about_axis("y", pitch) @ about_axis("x", roll)


def roll_pitch_yaw(R: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Roll, pitch and yaw with R = R_z(yaw) R_y(pitch) R_x(roll); exact at pitch 90° as well."""
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return float(roll), float(pitch), float(yaw)
