"""Forces on single parts of a robot: a body's wrench, a strut, the telescope bar, a bearing.

Everything is symbolic and linear in p. Frames are those of `docs/conventions.md`.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.speed_forces import Wrench
from deltaid.mechanism.mechanism import LimbBodies, MovingBody
from deltaid.mechanism.rotation import fixed
from deltaid.robot.limbs import LimbGeometry


@dataclass(frozen=True)
class ForceChannel:
    """One component of a force, such as the force along a strut at the platform.

    Attributes:
        name: as in files, such as 'strut1a.platform.x'.
        unit: N or N m.
        value: function of z, q̇, q̈ and p, linear in p.
    """

    name: str
    unit: str
    value: ca.SX


def vector(name: str, unit: str, value: ca.SX, axes: str = "xyz") -> list[ForceChannel]:
    """Channels of a vector's components along some axes."""
    return [ForceChannel(f"{name}.{axis}", unit, value["xyz".index(axis)]) for axis in axes]


@dataclass(frozen=True)
class LoadedBody:
    """A body and the wrench that its joints exert for its motion.

    Attributes:
        body: the body, one of `body.count` identical ones.
        taken: force and moment about its link frame's origin.
    """

    body: MovingBody
    taken: Wrench

    @property
    def force(self) -> ca.SX:
        """The force in the link frame [N]."""
        return self.body.rotation.R.T @ self.taken.push + self.taken.swing

    @property
    def inertial_force(self) -> ca.SX:
        """The force in the body's inertial frame L [N]."""
        return self.taken.push + self.body.rotation.R @ self.taken.swing

    @property
    def moment(self) -> ca.SX:
        """The moment in the link frame [N m]."""
        return ca.densify(self.taken.moment)

    @property
    def world_force(self) -> ca.SX:
        """The force in the world [N]."""
        return fixed(self.body.R_WL) @ self.inertial_force

    @property
    def world_moment(self) -> ca.SX:
        """The moment in the world [N m]."""
        return self.body.world_rotation @ self.taken.moment


@dataclass(frozen=True)
class Strut:
    """A strut of a limb with all forces except the one along it.

    Attributes:
        geometry: its limb.
        part: the strut's body with its wrench.
        R_LS: from the strut's frame to the limb's.
        r_E: the elbow from the origin of arm or carriage, in L [m].
        held: the middle of the limb's joints on the platform, in the world [m].
        across_S: force across the strut that the platform exerts on it, in S; its x is zero [N].
        spin: moment that the elbow exerts on it [N m].
        spin_axis: its axis, perpendicular to both axes of the universal joint, in S.
    """

    geometry: LimbGeometry
    part: LoadedBody
    R_LS: ca.SX
    r_E: ca.SX
    held: ca.SX
    across_S: ca.SX
    spin: ca.SX
    spin_axis: ca.SX

    @property
    def along(self) -> ca.SX:
        """Direction of the strut to the platform, in the world."""
        return self.part.body.world_rotation[:, 0]

    @property
    def across(self) -> ca.SX:
        """`across_S` in the world."""
        return self.part.body.world_rotation @ self.across_S


def strut_forces(geometry: LimbGeometry, limb: LimbBodies, part: LoadedBody) -> Strut:
    """A strut by its moments about the elbow, l x × f + μ n = moment, with the force f at the
    platform's end and the elbow's moment μ about n = y_L × z_S."""
    R_LS, l = limb.strut.rotation.R, limb.length
    y_S, m = R_LS[1, :].T, part.moment
    n = ca.vertcat(y_S[1], -y_S[0], 0)
    mu = m[0] / n[0]
    return Strut(
        geometry=geometry,
        part=part,
        R_LS=R_LS,
        r_E=limb.strut.origin.at - limb.driven.origin.at,
        held=limb.held,
        across_S=ca.vertcat(0, m[2] / l, (mu * n[1] - m[1]) / l),
        spin=mu,
        spin_axis=n,
    )


def bearing_load(
    strut: Strut, driven: LoadedBody, at_elbow: list[tuple[float, ca.SX, int]]
) -> tuple[ca.SX, ca.SX]:
    """Force and moment that base and drive exert on arm or carriage.

    The moment is about the origin of the body's link frame. Rotary: in L, the moment about y is the
    drive's. Linear: in a frame with y as in L and z up the rail, the force along −z is the drive's.

    Args:
        at_elbow: for each strut its distance from the middle along y, the force through its upper
            end in S, and the number of struts that it represents.
    """
    R_LD = driven.body.rotation.R
    force, moment = driven.inertial_force, R_LD @ driven.moment
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
    """The telescope bar.

    Attributes:
        channels: forces and torques of the universal joints on the bar, in its frame T, each torque
            about the axis perpendicular to both axes of its joint; and the drive's torque on the
            fork of the base joint, about world z.
        force, torque: of the platform joint on the bar, as vectors in the world [N, N m].
    """

    channels: list[ForceChannel]
    force: ca.SX
    torque: ca.SX


def bar_forces(
    length: ca.SX, upper: LoadedBody, lower: LoadedBody, tool: LoadedBody, slide: ca.SX
) -> Bar:
    """Forces on the telescope bar.

    Both crosses lie along x of the end effector and y of the bar, so torques act along
    n = x_E × y_T. The end effector's rotation determines the lower torque, moments about the upper
    joint the remaining forces, and the slide the force along the bar.

    Args:
        length: distance between the joints [m].
        slide: force for the slide's motion [N].
    """
    R_WT = upper.body.world_rotation
    n = ca.cross(R_WT.T @ tool.body.world_rotation[:, 0], ca.SX(ca.DM([0, 1, 0])))
    n_W = R_WT @ n
    lower_torque = -tool.world_moment[2] / n_W[2]
    moment = upper.moment + lower.moment + ca.cross(ca.vertcat(0, 0, -length), lower.force)
    torques = moment[2] / n[2]
    f = ca.vertcat(
        -(moment[1] - torques * n[1]) / length,
        (moment[0] - torques * n[0]) / length,
        lower.force[2] - slide,
    )
    upper_torque = torques - lower_torque
    channels = [
        *vector("telescope.base", "N", upper.force + lower.force - f),
        ForceChannel("telescope.base.torque", "N m", upper_torque),
        *vector("telescope.platform", "N", f),
        ForceChannel("telescope.platform.torque", "N m", lower_torque),
        ForceChannel("telescope.drive", "N m", upper_torque * n_W[2]),
    ]
    return Bar(channels, R_WT @ f, lower_torque * n_W)
