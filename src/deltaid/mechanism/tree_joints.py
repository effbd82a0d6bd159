"""Coordinates of all joints of the robot's spanning tree, as in MJCF and URDF.

For programs that only support trees, the robot is cut where struts and telescope meet the platform
(`exports.spanning_tree` has bodies, frames and axes). In the closed robot each joint's coordinate
is a function of z:

    limbN_swing   strut about the driven body's y: α, less q for an arm, which turns about y as well
    limbN_tilt    then about the strut's z: β, with x_S = (cos α cos β, sin β, −sin α cos β)
    bar_x, bar_y  a telescope's upper universal joint after its turn ψ, and slide, its length
    platform, partN_turn, tool, …   the joints between parts of the platform
    platform_x, middle_x, part1_x, tool_x, …   position of a part of the platform in the world

`JointStates` has their values, in the form of a ROS joint state message; `PassiveJoints` evaluates
how joints without a drive move along a motion, and `BallJoints` what those of struts lose.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.kernel.batch import RowKernel
from deltaid.mechanism.mechanism import Mechanism
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import I4Platform, Platform, RigidPlatform, Telescope
from deltaid.shown import Named

Samples = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class JointStates(Named):
    """Joints of the robot's tree, for one or many samples, as in `sensor_msgs/JointState`.

    Attributes:
        names: of the joints, as in the MJCF and URDF exports.
        position: [rad or m].
        velocity: [rad/s or m/s]; None where no drive velocities were given.
    """

    names: tuple[str, ...]
    position: Float[np.ndarray, "*samples joints"]
    velocity: Float[np.ndarray, "*samples joints"] | None


@dataclass(frozen=True, eq=False)
class TreeJoints:
    """Coordinates of some joints of the tree: ϑ(z) and its rate along a motion of the drives.

    Attributes:
        names: of the joints.
        z, qd: δ symbols each.
        position: ϑ [rad or m].
        velocity: ϑ̇ = ∂ϑ/∂z T q̇ [rad/s or m/s], T = ∂z/∂q.
    """

    names: tuple[str, ...]
    z: ca.SX
    qd: ca.SX
    position: ca.SX
    velocity: ca.SX

    def states(self, z: Samples, qd: Samples | None) -> JointStates:
        """Joint states at samples of a motion."""
        position, velocity = self._states.rows(z, np.zeros_like(z) if qd is None else qd)
        return JointStates(self.names, position, None if qd is None else velocity)

    @cached_property
    def _states(self) -> RowKernel:
        return RowKernel((self.z, self.qd), (self.position, self.velocity))


def tree_joints(
    robot: RobotDescription, mechanism: Mechanism, *, passive: bool = False
) -> TreeJoints:
    """All joints of the tree, drives first; or the passive ones.

    Raises:
        DeltaidError: the mechanism is user-defined, so its joints are not known.
    """
    coordinates = tree_coordinates(robot, mechanism)
    others = [name for name in coordinates if name not in robot.drives]
    names = (*(() if passive else robot.drives), *others)
    position = ca.vertcat(*(coordinates[name] for name in names))
    z, qd, T = mechanism.z, mechanism.speeds.q.u, mechanism.speeds.inverse_jacobian
    return TreeJoints(names, z, qd, position, ca.jacobian(position, z) @ (T @ qd))


def tree_coordinates(robot: RobotDescription, mechanism: Mechanism) -> dict[str, ca.SX]:
    """ϑ(z) of every joint of the tree by name, in the tree's order.

    Raises:
        DeltaidError: the mechanism is user-defined, so its joints are not known.
    """
    if robot.mechanism is not None:
        raise DeltaidError(
            "has a mechanism of its own, of which only poses are known and no joints",
            where=robot.name,
            cure="choose a target without bodies and joints: c, st, fmu, casadi or npz; poses are "
            "those of Kinematics.poses",
        )
    coordinates = _of_platform(robot.platform, mechanism.z)
    for i, limb in enumerate(mechanism.limbs):
        rotary, x_S = robot.limb_geometry[i].drive == "rotary", limb.strut.rotation.R[:, 0]
        q = mechanism.joints[f"drive{i + 1}"]
        swing = ca.atan2(-x_S[2], x_S[0]) - (q if rotary else 0)
        coordinates |= {
            f"drive{i + 1}": q,
            f"limb{i + 1}_swing": swing,
            f"limb{i + 1}_tilt": ca.asin(x_S[1]),
        }
    if robot.telescope is not None:
        coordinates |= _of_telescope(robot.telescope, mechanism.z)
    return coordinates


def _of_platform(platform: Platform, z: ca.SX) -> dict[str, ca.SX]:
    if isinstance(platform, RigidPlatform):
        return _positions("platform", z[:3])
    joint = z[3] / platform.ratio
    if isinstance(platform, I4Platform):
        first = z[:3] + 0.5 * joint * ca.DM(platform.direction)
        rack = {} if platform.tool_on != "middle" else {"tool_rack": 0.5 * joint}
        return _positions("part1", first) | {"platform": joint, "tool": z[3]} | rack
    turns = {"platform": joint, "part1_turn": -joint, "part2_turn": -joint}
    beside = _positions("tool", z[:3]) if platform.tool_on == "middle" else {}
    return _positions("middle", z[:3]) | turns | beside | {"tool": z[3]}


def _of_telescope(bar: Telescope, z: ca.SX) -> dict[str, ca.SX]:
    """R_WT = R_z(ψ) R_x(a) R_y(b) for the bar's halves, its length, and the tool's turn."""
    r, psi = z[:3], z[3]
    span = ca.DM(bar.base_joint) - r - ca.DM(bar.platform_joint)
    c, s = ca.cos(psi), ca.sin(psi)
    length = ca.sqrt(ca.sumsqr(span))
    x, y, z_bar = c * span[0] + s * span[1], c * span[1] - s * span[0], span[2]
    return {
        "drive4": psi,
        "bar_x": ca.atan2(-y, z_bar),
        "bar_y": ca.asin(x / length),
        "slide": length,
        "tool": psi,
    }


def _positions(name: str, r: ca.SX) -> dict[str, ca.SX]:
    return {f"{name}_{k}": r[i] for i, k in enumerate("xyz")}


@dataclass(frozen=True, eq=False)
class JointRates:
    """Joint motion at many samples.

    Attributes:
        speed, acceleration: ϑ̇, ϑ̈ [rad/s or m/s, and per s].
        slope: ∂ϑ/∂q.
    """

    speed: Float[np.ndarray, "samples joints"]
    acceleration: Float[np.ndarray, "samples joints"]
    slope: Float[np.ndarray, "samples joints dof"]


class PassiveJoints:
    """Some joints ϑ(z) of a mechanism: ϑ̇ = ∂ϑ/∂z T q̇ and its derivative, T = ∂z/∂q.

    Attributes:
        names: of the joints.
        moved_by: whether a drive moves a joint at all, (joints, dof).
    """

    def __init__(self, mechanism: Mechanism, names: Sequence[str]) -> None:
        self.names = tuple(names)
        s = mechanism.speeds
        coordinates = ca.vertcat(*(mechanism.joints[name] for name in names))
        slope = ca.jacobian(coordinates, mechanism.z) @ s.inverse_jacobian
        speed = slope @ s.q.u
        state, rates = ca.vertcat(mechanism.z, s.q.u), (s.inverse_jacobian @ s.q.u, s.q.ud)
        acceleration = ca.jtimes(speed, state, ca.vertcat(*rates))
        self.moved_by = np.array(ca.DM(slope.sparsity(), 1.0)) != 0
        self._kernel = RowKernel((state, s.q.ud), (speed, acceleration, ca.horzsplit(slope)))

    def rates(
        self,
        z: Float[np.ndarray, "samples dof"],
        qd: Float[np.ndarray, "samples dof"],
        qdd: Float[np.ndarray, "samples dof"],
    ) -> JointRates:
        """Joint motion at samples of a motion."""
        return JointRates(*self._kernel.rows(z, qd, qdd))


class BallJoints:
    """Ball joints at both ends of each limb's struts, which turn at ω_e on the arm or carriage and
    at ω_p on the platform, whose parts keep their orientation.

    A strut is free to turn about its own axis, so it turns half as fast as the arm does about that
    axis: friction is then the same at both ends.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        s, at_rest = mechanism.speeds, ca.SX.sym("at_rest")
        on_arms, on_platform = ca.SX(0), ca.SX(0)
        along = s.by_drives()
        for limb in mechanism.limbs:
            strut, driven = limb.strut.rotation, limb.driven.rotation
            of_driven = strut.R.T @ (driven.R @ driven.w)
            at_platform = ca.vertcat(0.5 * of_driven[0], strut.w[1:])
            w = along(ca.horzcat(at_platform, at_platform - of_driven))
            on_platform += ca.sqrt(ca.sumsqr(w[:, 0]) + at_rest**2)
            on_arms += ca.sqrt(ca.sumsqr(w[:, 1]) + at_rest**2)
        slopes = ca.jacobian(ca.vertcat(on_arms, on_platform), s.q.u).T
        self._kernel = RowKernel((mechanism.z, s.q.u), (ca.horzsplit(ca.densify(slopes)),), at_rest)

    def torques(
        self, z: Samples, qd: Samples, at_rest: float
    ) -> Float[np.ndarray, "samples dof 2"]:
        """Torques of the drives against 1 N m in each joint on arms or carriages, and on the
        platform: ∂/∂q̇ Σ |ω_e| and ∂/∂q̇ Σ |ω_p|.

        Args:
            z: platform coordinates [m, rad].
            qd: rates of the drives [rad/s or m/s].
            at_rest: rate below which a joint hardly turns [rad/s].
        """
        return self._kernel.rows(z, qd, uniform=np.array([at_rest]))[0]
