"""Limits of a robot, scaled to [−1, 1]; their use along a motion, and at rest in many poses."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.equations import TaskMotion, build_task_motion
from deltaid.errors import KinematicsError
from deltaid.kernel.batch import RowKernel
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.regularity import SINGULAR_CONDITION
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Box, Cylinder, Hemisphere

Shares = Float[np.ndarray, "samples limits"]


@dataclass(frozen=True)
class Limit:
    """One limit: u(z, ż, z̈) ≤ 1 and, if two-sided, u ≥ −1; |u| is its share in use."""

    name: str
    u: ca.SX
    two_sided: bool


def kind_of_limit(name: str) -> str:
    """Name of a limit without the number of its drive or strut."""
    return " ".join(re.sub(r"\d+", "", name).split())


def kinematic_limits(
    robot: RobotDescription, mechanism: Mechanism, motion: TaskMotion | None = None
) -> tuple[Limit, ...]:
    """All limits of the description except torques; without a motion, only those of a pose."""
    limits = workspace_limits(robot, mechanism.z)
    limits += _platform_rates(robot, motion) if motion else ()
    for i in range(len(robot.drives)):
        limits += _of_drive(robot, mechanism, motion, i)
    limits += _joints(robot, mechanism)
    condition = mechanism.condition / robot.largest_condition
    limits.append(Limit("distance from singularity", condition, False))
    # An articulated platform's parts must stay parallel; for a single part J implies this.
    if mechanism.hold is not None and robot.platform_turns:
        share = mechanism.hold_condition / robot.largest_condition
        limits.append(Limit("hold of the platform's parts", share, False))
    return tuple(limits)


def workspace_limits(robot: RobotDescription, z: ca.SX) -> list[Limit]:
    """Limits of the workspace, which come first in `kinematic_limits`."""
    space = robot.workspace
    if isinstance(space, Box):
        names = {"x": "workspace x", "y": "workspace y", "z": "workspace height"}
        given = ((name, getattr(space, name)) for name in robot.task.names if name in names)
        return [_between(names[name], z[i], bounds) for i, (name, bounds) in enumerate(given)]
    x, y, height = z[0], z[1], z[2]
    match space:
        case Cylinder():
            return [
                Limit("workspace radius", (x**2 + y**2) / space.radius**2, False),
                _between("workspace height", height, space.z),
            ]
        case Hemisphere():
            squared = x**2 + y**2 + (height - space.top) ** 2
            return [
                Limit("workspace sphere", squared / space.radius**2, False),
                Limit("workspace top", 1 + (height - space.top) / space.radius, False),
            ]


def _platform_rates(robot: RobotDescription, motion: TaskMotion) -> Iterator[Limit]:
    for i, axis in enumerate("xyz"[k] for k in robot.task.axes):
        yield Limit(f"platform speed {axis}", motion.zd[i] / robot.platform_speed, True)
        share = motion.zdd[i] / robot.platform_acceleration
        yield Limit(f"platform acceleration {axis}", share, True)
    if robot.platform_turns:  # a telescope's turn is limited by its drive; ψ is the last of z
        turn = robot.turn
        yield Limit("tool speed", motion.zd[-1] / turn.speed, True)
        yield Limit("tool acceleration", motion.zdd[-1] / turn.acceleration, True)


def torque_limits(robot: RobotDescription) -> dict[int, float]:
    """Largest torque of each limited drive, by its index in q [N m or N]."""
    efforts = {i: robot.limits_of(drive).effort for i, drive in enumerate(robot.drives)}
    return {i: effort for i, effort in efforts.items() if effort is not None}


def effort_names(robot: RobotDescription) -> tuple[str, ...]:
    """Names of the limits of `torque_limits`."""
    drives = (robot.drives[i] for i in torque_limits(robot))
    return tuple(f"{drive} {robot.units(drive).effort}" for drive in drives)


def effort_limits(robot: RobotDescription) -> Float[np.ndarray, " dof"]:
    """Largest torque or force of each drive; infinite where the description has none."""
    given = torque_limits(robot)
    return np.array([given.get(i, np.inf) for i in range(len(robot.drives))])


def _of_drive(
    robot: RobotDescription, mechanism: Mechanism, motion: TaskMotion | None, i: int
) -> Iterator[Limit]:
    drive, given = robot.drives[i], robot.limits_of(robot.drives[i])
    if given.range is not None:
        yield _between(f"{drive} {robot.units(drive).motion}", mechanism.q[i], given.range)
    if motion and given.top_speed is not None:
        yield Limit(f"{drive} speed", motion.qd[i] / given.top_speed, True)
    if motion and given.top_acceleration is not None:
        yield Limit(f"{drive} acceleration", motion.qdd[i] / given.top_acceleration, True)


def _joints(robot: RobotDescription, mechanism: Mechanism) -> Iterator[Limit]:
    """Limits of the struts' sideways swing in their ball joints, and of the telescope's stroke."""
    if robot.strut_swing_deg is not None:
        largest = np.sin(np.deg2rad(robot.strut_swing_deg))
        for i, limb in enumerate(mechanism.limbs):
            # y of the limb's frame is the motor axis, x of the strut its direction.
            yield Limit(f"strut {i + 1} swing", limb.strut.rotation.R[1, 0] / largest, True)
    if robot.platform_turns:
        yield _between("tool angle", mechanism.z[-1], (robot.turn.low, robot.turn.high))
    if robot.telescope is not None and robot.telescope.stroke is not None:
        slide = mechanism.joints["slide"]
        yield _between("telescope length", slide, robot.telescope.stroke)


def _between(name: str, value: ca.SX, bounds: tuple[float, float]) -> Limit:
    low, high = bounds
    return Limit(name, (value - 0.5 * (low + high)) / (0.5 * (high - low)), True)


class LimitsAlong:
    """Use of a robot's limits, 1 at the limit, sample by sample.

    Attributes:
        names: of the limits that need no torque, in the order of `kinematic`.
        efforts: names of the drives' torque or force limits, in the order of `effort`.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        robot, mechanism = dynamics.robot, dynamics.kinematics.mechanism
        self._motion = build_task_motion(robot, mechanism)
        self._limits = kinematic_limits(robot, mechanism, self._motion)
        self.names: tuple[str, ...] = tuple(limit.name for limit in self._limits)
        self.efforts: tuple[str, ...] = effort_names(robot)
        m, shares = self._motion, [limit.u for limit in self._limits]
        self._kernel = RowKernel((m.z, m.zd, m.zdd), [ca.vertcat(*shares)])

    def kinematic(self, z: Samples, zd: Samples, zdd: Samples) -> Shares:
        """Use of speeds, accelerations, ranges, workspace and distance from singularities."""
        (u,) = self._kernel.rows(z, zd, zdd)
        return np.where([limit.two_sided for limit in self._limits], np.abs(u), u)

    def effort(self, z: Samples, zd: Samples, zdd: Samples, p: Parameters) -> Shares:
        """Use of the drives' torques, with parameters p."""
        _, qd, qdd = self.dynamics.kinematics.drive_motion(z, zd, zdd)
        tau, largest = self.dynamics.torque(z, qd, qdd, p), torque_limits(self.dynamics.robot)
        return np.abs(tau[:, list(largest)]) / np.array(list(largest.values()))


@dataclass(frozen=True)
class Poses:
    """A robot at rest in many poses, one pose a row.

    Attributes:
        z: task coordinates [m; rad].
        q: drive coordinates [rad or m].
        torque: holding torques of the drives: gravity, springs, offsets of friction [N m or N].
        condition: ‖J‖_F ‖J⁻¹‖_F / δ.
        shares: use |u| of each limit, 1 at the limit, in the order of `AtRest.limits`.
        stands: whether the pose exists: every limb reaches it, and it lies on the home pose's side
            of singularities. Elsewhere all other attributes except z are NaN.
    """

    z: Samples
    q: Samples
    torque: Samples
    condition: Float[np.ndarray, " samples"]
    shares: Float[np.ndarray, "samples limits"]
    stands: Bool[np.ndarray, " samples"]

    def only(self, chosen: Bool[np.ndarray, " samples"]) -> "Poses":
        """A subset of the poses."""
        return Poses(*(array[chosen] for array in vars(self).values()))


class AtRest:
    """A robot with parameters p, evaluated at rest.

    Attributes:
        limits: names of all limits that a pose alone can break: first those of the workspace, then
            those of the machine.
        of_workspace: number of limits of the workspace.

    Raises:
        KinematicsError: the middle of the workspace is out of reach or singular.
    """

    def __init__(self, dynamics: Dynamics, p: Parameters) -> None:
        self.dynamics, self.p = dynamics, p
        self.robot: RobotDescription = dynamics.robot
        mechanism = dynamics.kinematics.mechanism
        posed = kinematic_limits(self.robot, mechanism)
        names = (*(limit.name for limit in posed), *effort_names(self.robot))
        self.limits: tuple[str, ...] = names
        self.of_workspace = len(workspace_limits(self.robot, mechanism.z))
        # q, torque, condition, shares, det J and reach of z; p is uniform
        e, still = dynamics.equations, ca.SX.zeros(2 * mechanism.dof)
        torque = ca.substitute(ca.densify(e.torque), ca.vertcat(e.qd, e.qdd), still)
        shares = [limit.u for limit in posed]
        shares += [torque[i] / largest for i, largest in torque_limits(self.robot).items()]
        judged = mechanism.condition, ca.vertcat(*shares), ca.det(mechanism.scaled_jacobian)
        self._kernel = RowKernel([e.z], (mechanism.q, torque, *judged, mechanism.reach), e.p)
        self.home = dynamics.kinematics.home
        dynamics.kinematics.inverse(self.home[None])  # raises with the limb that does not reach
        dynamics.kinematics.require_regular(self.home[None])
        self._side = np.sign(dynamics.kinematics.regularity(self.home[None]).determinant[0])

    def __call__(self, z: Samples) -> Poses:
        """The robot at rest at some poses."""
        z = np.asarray(z, dtype=float)
        parts = self._kernel.rows(z, uniform=self.p)
        q, torque, condition, shares, determinant, reach = parts
        stands = np.all(reach > 0, axis=1) & (np.sign(determinant[:, 0]) == self._side)
        stands &= (condition[:, 0] < SINGULAR_CONDITION) & np.all(np.isfinite(q), axis=1)
        gone = ~stands[:, None]
        return Poses(
            z=z,
            q=np.where(gone, np.nan, q),
            torque=np.where(gone, np.nan, torque),
            condition=np.where(stands, condition[:, 0], np.nan),
            shares=np.where(gone, np.nan, np.abs(shares)),
            stands=stands,
        )

    def why_not(self, z: Float[np.ndarray, " dof"]) -> str:
        """Why a pose does not exist."""
        kinematics = self.dynamics.kinematics
        try:
            kinematics.inverse(z[None])
            kinematics.require_regular(z[None])
        except KinematicsError as error:
            return error.what
        return "every limb reaches the pose, but it lies beyond a singularity from the home pose"
