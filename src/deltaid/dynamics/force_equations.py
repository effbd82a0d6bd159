"""Forces in struts, joints and bearings as CasADi graphs, linear in the parameters p.

Newton's and Euler's laws for every body, solved from the free ends inwards:

1. Strut, between a universal joint at the elbow and a ball joint at the platform. Its inertia
   determines the force across it and the moment about its axis; the force N along it is unknown.
2. Telescope bar, between its universal joints. Its inertia, the moment that turns the end effector
   and friction in the slide determine all forces.
3. Platform. With locked drives a virtual motion δz stretches the struts of limb i by
   x_iᵀ (∂a_i/∂z) δz (x_i along the strut, a_i the middle of its joints on the platform), so the
   sums N_i of the forces along a limb's struts solve Aᵀ N = −Q with A = [x_iᵀ ∂a_i/∂z] and the
   generalised forces Q of inertia, gravity and joints on z.
4. Rotations that the struts prevent: of the platform about three axes, and for H4 of one side bar
   against the other. Such a turn δφ stretches the two struts at ± h y_i (y_i the motor axis)
   differently, by ± h x_i · (∂ω/∂φ × y_i) δφ. So the differences D_i of the forces of a pair solve
   one equation for each rotation, as many as limbs.
5. Upper arm or carriage. The balance of its forces determines the load of its bearing.

Only the telescope's slide and the platform's own joint have friction (H4: where the middle bar
meets the first side bar). The tool of an H4 turns in the middle bar and is geared to the first side
bar. Inertia of motors and gears does not load the bearings.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.dynamics.force_parts import (
    ForceChannel,
    LoadedBody,
    Strut,
    bar_forces,
    bearing_load,
    strut_forces,
    vector,
)
from deltaid.dynamics.speed_forces import SpeedForces
from deltaid.errors import DescriptionError
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.rotation import inverse
from deltaid.robot.description import RobotDescription
from deltaid.robot.limbs import LimbGeometry
from deltaid.robot.platform import PASSIVE_JOINTS, H4Platform


@dataclass(frozen=True)
class ForceEquations:
    """All forces of one robot.

    Attributes:
        z, qd, qdd, p: inputs.
        channels: all force channels.
        struts: names of the struts, or of the pairs where only the sum of forces is determined.
    """

    z: ca.SX
    qd: ca.SX
    qdd: ca.SX
    p: ca.SX
    channels: tuple[ForceChannel, ...]
    struts: tuple[str, ...]


def unknown_joints(wanted: str, where: str) -> DescriptionError:
    """Error for forces that the description of a user-defined mechanism does not determine."""
    return DescriptionError(
        "a mechanism of your own says how bodies move, but not which joints carry them, so "
        f"{wanted} cannot be computed",
        where=where,
        cure="describe the robot by limbs and platform if it is composed of them",
    )


def splits(robot: RobotDescription) -> bool:
    """Whether the force of each strut of a pair is determined, not only their sum."""
    known = all(limb.spacing is not None for limb in robot.limb_geometry)
    return known and robot.platform.determines_struts


def build_forces(robot: RobotDescription, mechanism: Mechanism) -> ForceEquations:
    """Derive the forces of a robot with limbs and a platform."""
    forces, speeds = SpeedForces(robot, mechanism), mechanism.speeds
    channels, struts = _Build(robot, mechanism, forces).channels()
    values = speeds.by_drives()(ca.vertcat(*[c.value for c in channels]))
    return ForceEquations(
        z=mechanism.z,
        qd=speeds.q.u,
        qdd=speeds.q.ud,
        p=forces.p,
        channels=tuple(ForceChannel(c.name, c.unit, values[k]) for k, c in enumerate(channels)),
        struts=struts,
    )


@dataclass(frozen=True)
class _Turn:
    """A virtual rotation that the struts prevent: its axis, a point of the axis, and the bodies and
    limbs that move."""

    axis: ca.SX
    centre: ca.SX
    parts: tuple[LoadedBody, ...]
    limbs: tuple[int, ...]

    def moment(self, point: ca.SX, force: ca.SX) -> ca.SX:
        """Virtual work of a force at a point, per unit of rotation."""
        return ca.dot(self.axis, ca.cross(point - self.centre, force))


class _Build:
    """The steps above for one robot, as functions of the mechanism's speeds."""

    def __init__(self, robot: RobotDescription, mechanism: Mechanism, forces: SpeedForces) -> None:
        self._robot, self._mechanism, self._forces = robot, mechanism, forces
        self._z = mechanism.z
        self._driven = [self._loaded(limb.driven) for limb in mechanism.limbs]
        self._struts = [
            strut_forces(geometry, limb, self._loaded(limb.strut))
            for geometry, limb in zip(robot.limb_geometry, mechanism.limbs, strict=True)
        ]
        self._platform = tuple(self._loaded(body) for body in mechanism.platform)
        self._telescope = tuple(self._loaded(body) for body in mechanism.telescope)
        self._bar = None
        if self._telescope:
            upper, lower, tool = self._telescope
            length, slide = mechanism.joints["slide"], forces.effort("slide")
            self._bar = bar_forces(length, upper, lower, tool, slide)

    def _loaded(self, body: MovingBody) -> LoadedBody:
        return LoadedBody(body, self._forces.wrench(body))

    def channels(self) -> tuple[list[ForceChannel], tuple[str, ...]]:
        """All channels, and the names of the struts."""
        sums = self._sums()
        differences = self._differences(sums) if splits(self._robot) else None
        collected, names = [], []
        for i, strut in enumerate(self._struts):
            geometry, N = strut.geometry, sums[i]
            if differences is None:
                sides = ((f"strut{i + 1}", 0.0, N, geometry.struts),)
            else:
                D, h = differences[i], _half(geometry)
                sides = (
                    (f"strut{i + 1}a", h, 0.5 * (N + D), 1),
                    (f"strut{i + 1}b", -h, 0.5 * (N - D), 1),
                )
            at_elbow = []
            for name, aside, along, count in sides:
                names.append(name)
                inner = count * strut.across_S + ca.vertcat(along, 0, 0)
                outer = inner - count * strut.part.force
                at_elbow.append((aside, outer, count))
                collected += _strut_channels(name, strut, inner, outer, count)
                if aside:
                    collected += _socket_channels(name, strut, inner, outer, np.sign(aside))
            complete = differences is not None or geometry.struts == 1
            collected += _bearing_channels(i, strut, self._driven[i], at_elbow, complete)
        return collected + (self._bar.channels if self._bar else []), tuple(names)

    def _sums(self) -> ca.SX:
        """N_i of step 3. A telescope's ψ is held by its own drive."""
        n, z, forces = len(self._struts), self._z, self._forces
        on_speeds = ca.SX.zeros(self._mechanism.speeds.u.numel())
        for part in (*self._platform, *self._telescope):
            on_speeds += part.body.count * forces.on_speeds(part.body, part.taken)
        for joint in PASSIVE_JOINTS:
            if joint in self._mechanism.joints:
                on_speeds += forces.effort(joint) * forces.joint(joint).partial.T
        Q, rows = self._mechanism.speeds.locked_to_all.T @ on_speeds, []
        for strut in self._struts:
            motion = ca.jacobian(strut.held, z)
            Q += motion.T @ (strut.geometry.struts * strut.across)
            rows.append(strut.along.T @ motion)
        return -inverse(ca.vertcat(*rows)[:, :n].T) @ Q[:n]

    def _differences(self, sums: ca.SX) -> ca.SX:
        """Differences D_i of step 4."""
        turns, n = self._turns(), len(self._struts)
        A, work = ca.SX(n, n), ca.SX.zeros(n)
        for j, turn in enumerate(turns):
            for part in turn.parts:
                work[j] += ca.dot(turn.axis, part.world_moment)
                work[j] += turn.moment(part.body.world_origin, part.world_force)
            if self._bar is not None:
                work[j] += ca.dot(turn.axis, self._bar.torque)
                work[j] += turn.moment(self._telescope[1].body.world_origin, self._bar.force)
            for i in turn.limbs:
                strut = self._struts[i]
                force = strut.geometry.struts * strut.across + strut.along * sums[i]
                work[j] += turn.moment(strut.held, force)
                y = ca.SX(ca.DM(strut.geometry.R_WL[:, 1]))
                stretch = ca.dot(ca.cross(turn.axis, y), strut.along)
                A[j, i] = _half(strut.geometry) * stretch
        return -inverse(A) @ work

    def _turns(self) -> list[_Turn]:
        """Rotations of the whole platform with the end effector of a telescope, and for an H4 that
        of the second side bar."""
        platform = self._robot.platform
        parts = self._platform + self._telescope[2:]
        limbs = tuple(range(len(self._struts)))
        axes = [ca.SX(ca.DM(axis)) for axis in np.eye(3)]
        turns = [_Turn(axis, self._z[:3], parts, limbs) for axis in axes]
        if isinstance(platform, H4Platform):
            second = self._platform[1]
            held = tuple(i for i in limbs if not platform.on_first(i))
            turns.append(_Turn(axes[2], second.body.world_origin, (second,), held))
        return turns


def _half(geometry: LimbGeometry) -> float:
    return 0.5 * float(geometry.spacing or 0.0)


def _strut_channels(
    name: str, strut: Strut, inner: ca.SX, outer: ca.SX, count: int
) -> list[ForceChannel]:
    """Forces through both ends in the strut's frame; tension is positive."""
    return [
        *vector(f"{name}.platform", "N", inner),
        *vector(f"{name}.elbow", "N", outer),
        ForceChannel(f"{name}.elbow.moment", "N m", count * strut.spin),
    ]


def _socket_channels(
    name: str, strut: Strut, inner: ca.SX, outer: ca.SX, side: float
) -> list[ForceChannel]:
    """Force of the ball away from its twin; a socket opens where it is below minus the spring
    force."""
    y_S = strut.R_LS[1, :].T
    return [
        ForceChannel(f"{name}.platform.out", "N", side * ca.dot(y_S, inner)),
        ForceChannel(f"{name}.elbow.out", "N", -side * ca.dot(y_S, outer)),
    ]


def _bearing_channels(
    i: int,
    strut: Strut,
    driven: LoadedBody,
    at_elbow: list[tuple[float, ca.SX, int]],
    complete: bool,
) -> list[ForceChannel]:
    """Loads of the bearing of arm or carriage; without moments where single struts are
    undetermined."""
    force, moment = bearing_load(strut, driven, at_elbow)
    name, rotary = f"motor{i + 1}", strut.geometry.drive == "rotary"
    forces = vector(f"{name}.force", "N", force, "xyz" if rotary else "xy")
    moments = vector(f"{name}.moment", "N m", moment, "xz" if rotary else "xyz")
    drive = ("N m", moment[1]) if rotary else ("N", -force[2])
    return [*forces, *(moments if complete else []), ForceChannel(f"{name}.drive", *drive)]
