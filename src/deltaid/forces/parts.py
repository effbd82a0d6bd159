"""Forces on single parts of a robot: a body's wrench, a strut, the telescope bar, a bearing.

Everything is symbolic and linear in p. Frames are those of `docs/conventions.md`.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.joint_columns import JointMotion, joint_columns
from deltaid.dynamics.parameters import parameter_layout
from deltaid.dynamics.rigid_body import body_motion
from deltaid.mechanism.mechanism import LimbBodies, Mechanism, MovingBody
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry


@dataclass(frozen=True)
class Wrench:
    """What one body's motion takes from its joints, gravity taken off.

    Attributes:
        body: whose it is.
        force, moment: about the link frame's origin, in the link frame [N, N m].
        on_z: its generalised forces on z.
    """

    body: MovingBody
    force: ca.SX
    moment: ca.SX
    on_z: ca.SX

    @property
    def rotation(self) -> ca.SX:
        """Rotation from the link frame to the world."""
        return ca.SX(ca.DM(self.body.R_WL)) @ self.body.R_LB

    @property
    def origin(self) -> ca.SX:
        """Origin of the link frame in the world [m]."""
        return ca.SX(ca.DM(self.body.R_WL)) @ self.body.r_LB

    @property
    def world_force(self) -> ca.SX:
        """The force in the world [N]."""
        return self.rotation @ self.force

    @property
    def world_moment(self) -> ca.SX:
        """The moment in the world [N m]."""
        return self.rotation @ self.moment


def body_wrench(
    robot: RobotDescription, z: ca.SX, body: MovingBody, v: ca.SX, a: ca.SX, p: ca.SX
) -> Wrench:
    """Newton's and Euler's laws as in `dynamics.rigid_body`, for one of `body.count` bodies."""
    motion = body_motion(body, z, v, a, np.array(robot.gravity))
    p_b = p[parameter_layout(robot).body(body.name)]
    m, mc = p_b[0], p_b[1:4]
    Theta = ca.vertcat(
        ca.horzcat(p_b[4], p_b[7], p_b[9]),
        ca.horzcat(p_b[7], p_b[5], p_b[8]),
        ca.horzcat(p_b[9], p_b[8], p_b[6]),
    )
    w, alpha = ca.densify(motion.w), ca.densify(motion.alpha)
    force = m * motion.a + ca.cross(alpha, mc) + ca.cross(w, ca.cross(w, mc))
    moment = ca.cross(mc, ca.densify(motion.a)) + Theta @ alpha + ca.cross(w, Theta @ w)
    return Wrench(body, force, moment, motion.J_v.T @ force + motion.J_w.T @ moment)


def joint_effort(
    robot: RobotDescription, mechanism: Mechanism, joint: str, v: ca.SX, p: ca.SX
) -> ca.SX:
    """Friction and spring of a joint that is no drive: force or torque that its motion takes."""
    layout, coordinate = parameter_layout(robot), mechanism.joints[joint]
    speed, effort = ca.jtimes(coordinate, mechanism.z, v), ca.SX(0)
    motion = JointMotion(coordinate, speed, ca.SX(0), ca.SX(0))
    for k, column in enumerate(joint_columns(robot), start=layout.coefficients.start):
        if column.joint == joint:
            effort += p[k] * column.effort(motion)
    return effort


@dataclass(frozen=True)
class Strut:
    """One strut of a limb without the force along it.

    Attributes:
        geometry: its limb.
        wrench: what its motion takes.
        R_LS: from the strut's frame to the limb's.
        r_E: the elbow from the origin of arm or carriage, in L [m].
        held: the middle of the limb's joints on the platform, in the world [m].
        across_S: force across the strut that the platform exerts on it, in S; its x is zero [N].
        spin: moment that the elbow exerts on it [N m].
        spin_axis: its axis, perpendicular to both axes of the universal joint, in S.
    """

    geometry: LimbGeometry
    wrench: Wrench
    R_LS: ca.SX
    r_E: ca.SX
    held: ca.SX
    across_S: ca.SX
    spin: ca.SX
    spin_axis: ca.SX

    @property
    def along(self) -> ca.SX:
        """Along the strut to the platform, in the world."""
        return self.wrench.rotation[:, 0]

    @property
    def across(self) -> ca.SX:
        """`across_S` in the world."""
        return self.wrench.rotation @ self.across_S


def strut_forces(geometry: LimbGeometry, limb: LimbBodies, wrench: Wrench) -> Strut:
    """Moments about the elbow, with the force f at the platform's end and the moment μ n of the
    elbow: l x × f + μ n = moment, n = y_L × z_S."""
    R_LS, l = limb.strut.R_LB, geometry.strut
    y_S, m = R_LS[1, :].T, wrench.moment
    n = ca.vertcat(y_S[1], -y_S[0], 0)
    mu = m[0] / n[0]
    return Strut(
        geometry=geometry,
        wrench=wrench,
        R_LS=R_LS,
        r_E=limb.strut.r_LB - limb.driven.r_LB,
        held=limb.held,
        across_S=ca.vertcat(0, m[2] / l, (mu * n[1] - m[1]) / l),
        spin=mu,
        spin_axis=n,
    )


def bearing_load(
    strut: Strut, driven: Wrench, at_elbow: list[tuple[float, ca.SX, int]]
) -> tuple[ca.SX, ca.SX]:
    """Force and moment that arm or carriage takes from base and drive.

    About the origin of the body's link frame. Rotary: in L, the moment about y is the drive's.
    Linear: in a frame with y as in L and z up the rail, the force along −z is the drive's.

    Args:
        at_elbow: for each strut its distance from the middle along y, the force through its upper
            end in S, and how many struts that stands for.
    """
    R_LD = driven.body.R_LB
    force, moment = R_LD @ driven.force, R_LD @ driven.moment
    for aside, through, count in at_elbow:
        on_strut = -strut.R_LS @ through
        force += on_strut
        moment += ca.cross(strut.r_E + ca.SX(ca.DM([0, aside, 0])), on_strut)
        moment += count * strut.spin * (strut.R_LS @ strut.spin_axis)
    if strut.geometry.drive == "rotary":
        return force, moment
    up, y = -strut.geometry.rail, np.array([0.0, 1.0, 0.0])
    R = ca.DM(np.column_stack([np.cross(y, up), y, up]).T)
    return R @ force, R @ moment


@dataclass(frozen=True)
class Bar:
    """The telescope bar. Forces and torques are those of the joints on the bar, in its frame T.

    Attributes:
        r_lower: centre of the joint at the platform, in the world [m].
        upper_force, lower_force: [N].
        upper_torque, lower_torque: about the axis perpendicular to both axes of a joint [N m].
        lower_force_W, lower_torque_W: in the world; the torque as a vector.
        drive: torque on the fork of the joint at the base, about world z [N m].
    """

    r_lower: ca.SX
    upper_force: ca.SX
    upper_torque: ca.SX
    lower_force: ca.SX
    lower_torque: ca.SX
    lower_force_W: ca.SX
    lower_torque_W: ca.SX
    drive: ca.SX


def bar_forces(length: ca.SX, upper: Wrench, lower: Wrench, tool: Wrench, slide: ca.SX) -> Bar:
    """Both crosses lie along x of the end effector and y of the bar, so torques go along
    n = x_E × y_T. The end effector's turn gives the lower one, moments about the upper joint the
    rest, and the slide the force along the bar.

    Args:
        length: distance of the joints [m].
        slide: force that the slide's motion takes [N].
    """
    R_WT = upper.rotation
    x = R_WT.T @ tool.rotation[:, 0]
    n = ca.cross(x, ca.SX(ca.DM([0, 1, 0])))
    n_W = R_WT @ n
    lower_torque = -tool.world_moment[2] / n_W[2]
    moment = upper.moment + lower.moment
    moment += ca.cross(ca.vertcat(0, 0, -length), lower.force)
    torques = moment[2] / n[2]
    f = ca.vertcat(
        -(moment[1] - torques * n[1]) / length,
        (moment[0] - torques * n[0]) / length,
        lower.force[2] - slide,
    )
    upper_torque = torques - lower_torque
    return Bar(
        r_lower=lower.origin,
        upper_force=upper.force + lower.force - f,
        upper_torque=upper_torque,
        lower_force=f,
        lower_torque=lower_torque,
        lower_force_W=R_WT @ f,
        lower_torque_W=lower_torque * n_W,
        drive=upper_torque * n_W[2],
    )
