"""Sensors of forces inside a robot: along a strut, and behind a gear.

A gauge on a strut, or on both struts of a limb, measures the axial force, tension positive. At the
platform's joint and at the elbow's, `dynamics.force_equations` gives it, together with the moment
that the elbow exerts about the axis perpendicular to both of its axes. At a cut between them, the
part of the strut beyond the cut has a mass m_o and a first moment mc_o:

    N = N_platform − x · (m_o (a − g) + ω × (ω × mc_o) + ω̇ × mc_o),    mc_o along x.

A torque sensor between gear and arm measures the drive's row of Y without the motor: friction, load
friction and rotor of the drive are on the motor's side. Springs across the joint and the torques of
all other joints are on the link's side. For a rail it is a force sensor between spindle and
carriage.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.force_equations import ForceEquations, build_forces, splits, unknown_joints
from deltaid.dynamics.joint_columns import joint_columns
from deltaid.dynamics.speed_forces import SpeedForces, wrench
from deltaid.errors import DescriptionError
from deltaid.robot.parameter import PriorParameter
from deltaid.robot.sensors import JointTorque, StrutForce
from deltaid.sensors.rows import SensorRows, Unknown, wide_force, wide_moment


@dataclass(frozen=True, eq=False)
class StrutForceRows(SensorRows):
    """Rows of one gauge on a strut.

    Raises:
        DescriptionError: no such strut, or only the sum of a limb's struts is determined.
    """

    sensor: StrutForce

    def __post_init__(self) -> None:
        _ = self._struts

    @cached_property
    def still(self) -> tuple[Unknown, ...]:
        bias = wide_force(self.dynamics) if self.sensor.bias is None else self.sensor.bias
        return (*self.bias(0, "bias", bias), *self.gain(self.sensor.gain_tolerance))

    @property
    def graph(self) -> ca.SX:
        forces = _equations(self.dynamics)
        values = {channel.name: channel.value for channel in forces.channels}
        end = "elbow" if self.sensor.at == "elbow" else "platform"
        along = [values[f"{strut}.{end}.x"] for strut in self._struts]
        columns = ca.jacobian(sum(along[1:], along[0]), forces.p)
        return ca.horzcat(columns, self._beyond()) if self.sensor.at == "middle" else columns

    @property
    def moving(self) -> tuple[PriorParameter, ...]:
        """Mass and first moment of one strut beyond the cut; priors are those of a uniform strut's
        outer half."""
        if self.sensor.at != "middle":
            return ()
        m = self.dynamics.robot.bodies[self._body.name].prior_parameters()[0]
        l = self.dynamics.robot.limb_geometry[self._limb].strut
        return (
            self.unknown("outer_m", "kg", 0.5 * float(m), 0.5 * float(m)),
            self.unknown("outer_mcx", "kg m", 0.25 * float(m * l), 0.375 * float(m * l)),
        )

    def _beyond(self) -> ca.SX:
        """Columns of mass and first moment of the part beyond the cut."""
        mechanism, body = self.dynamics.kinematics.mechanism, self._body
        turned, part = body.rotation, ca.SX.sym("part", 2)
        a = body.origin.acceleration - SpeedForces(self.dynamics.robot, mechanism).gravity(body)
        taken = wrench(turned.R, ca.vertcat(part, ca.SX(8, 1)), a, turned.alpha, turned.w)
        along = (turned.R.T @ taken.push + taken.swing)[0]
        single = self.sensor.strut[-1] in "ab"
        count = 1 if single else self.dynamics.robot.limb_geometry[self._limb].struts
        return mechanism.speeds.by_drives()(-count * ca.jacobian(along, part))

    @property
    def _limb(self) -> int:
        return int(self.sensor.strut.removeprefix("strut").rstrip("ab")) - 1

    @property
    def _body(self):
        return self.dynamics.kinematics.mechanism.limbs[self._limb].strut

    @cached_property
    def _struts(self) -> tuple[str, ...]:
        """Names of the determined strut forces whose sum the gauge measures."""
        wanted, where = self.sensor.strut, f"sensors.{self.name}.strut"
        if self.dynamics.robot.mechanism is not None:
            raise unknown_joints("forces along struts", where)
        known = _equations(self.dynamics).struts
        if wanted in known:
            return (wanted,)
        both = tuple(f"{wanted}{side}" for side in "ab")
        if set(both) <= set(known):
            return both
        if wanted[:-1] in known and wanted[-1] in "ab":
            raise _only_sums(self.dynamics, where, wanted)
        raise DescriptionError(
            f"there is no strut '{wanted}'; there are {', '.join(known)}"
            + (", and strut1, … for the sums of limbs" if splits(self.dynamics.robot) else ""),
            where=where,
            cure="name one of these",
        )


@lru_cache(maxsize=8)
def _equations(dynamics: Dynamics) -> ForceEquations:
    return build_forces(dynamics.robot, dynamics.kinematics.mechanism)


def _only_sums(dynamics: Dynamics, where: str, wanted: str) -> DescriptionError:
    robot, limb = dynamics.robot, wanted[:-1]
    if robot.limb_geometry[0].struts == 1:
        return DescriptionError(
            "the limbs have one strut each", where=where, cure=f"name it {limb}"
        )
    if robot.platform.determines_struts:
        return DescriptionError(
            f"how {limb} shares its force between its two struts follows from their distance, "
            "which is not described",
            where=where,
            cure=f"give limbs.strut_spacing, or name the sum of both, {limb}",
        )
    return DescriptionError(
        f"how {limb} shares its force between its two struts depends on how stiff they are: a "
        f"platform of kind {robot.platform.kind} has one joint less than its eight struts need",
        where=where,
        cure=f"put gauges on both and name the sum, {limb}",
    )


@dataclass(frozen=True, eq=False)
class JointTorqueRows(SensorRows):
    """Rows of one joint torque sensor.

    Raises:
        DescriptionError: the drive does not exist.
    """

    sensor: JointTorque

    def __post_init__(self) -> None:
        drives = self.dynamics.robot.drives
        if self.sensor.drive not in drives:
            raise DescriptionError(
                f"there is no drive '{self.sensor.drive}'; there are {', '.join(drives)}",
                where=f"sensors.{self.name}.drive",
                cure="name one of these",
            )

    @cached_property
    def still(self) -> tuple[Unknown, ...]:
        dynamics, bias = self.dynamics, self.sensor.bias
        if bias is None:
            slides = dynamics.robot.is_linear(self.sensor.drive)
            bias = wide_force(dynamics) if slides else wide_moment(dynamics, np.zeros(3))
        return (*self.bias(0, "bias", bias), *self.gain(self.sensor.gain_tolerance))

    @property
    def graph(self) -> ca.SX:
        robot, layout = self.dynamics.robot, self.dynamics.layout
        row = self.dynamics.equations.Y[robot.drives.index(self.sensor.drive), :]
        motor = {
            k
            for k, column in enumerate(joint_columns(robot), start=layout.coefficients.start)
            if column.joint == self.sensor.drive and column.parameter.kind != "spring"
        }
        return ca.horzcat(*(ca.SX(1, 1) if k in motor else row[k] for k in range(row.numel())))
