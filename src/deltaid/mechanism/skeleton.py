"""A robot as line segments for drawing: arms or rails, struts, platform and tool, telescope.

All segments follow from the poses of the moving bodies, so the drawing shows the computed model.
Only the distance between the two struts of a parallelogram, which changes no motion, is drawn as
half the radius of platform or base.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import LimbBodies, Mechanism
from deltaid.robot.description import RobotDescription
from deltaid.robot.platform import RigidPlatform

_BASE = "base"


@dataclass(frozen=True)
class Segment:
    """A straight part of a body: both ends in the world [m], functions of z."""

    body: str
    start: ca.SX
    end: ca.SX


class Skeleton:
    """The segments of a robot, evaluated for many samples."""

    def __init__(self, robot: RobotDescription, mechanism: Mechanism) -> None:
        drawn = _segments if robot.mechanism is None else _drawn_by_user
        self.segments: tuple[Segment, ...] = tuple(drawn(robot, mechanism))
        ends = [point for s in self.segments for point in (s.start, s.end)]
        self._kernel = BatchKernel(mechanism.z, ca.vertcat(*[ca.densify(e) for e in ends]))

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that have segments, each once."""
        return tuple(dict.fromkeys(segment.body for segment in self.segments))

    def evaluate(
        self, z: Float[np.ndarray, "samples dof"]
    ) -> Float[np.ndarray, "samples segments 2 3"]:
        """Both ends of every segment in the world [m]."""
        return self._kernel(z.T).T.reshape(len(z), len(self.segments), 2, 3)


def _segments(robot: RobotDescription, mechanism: Mechanism) -> Iterator[Segment]:
    half, base, held = 0.5 * drawn_spacing(robot), list[ca.SX](), dict[bool, list[ca.SX]]()
    for i, (geometry, limb) in enumerate(zip(robot.limb_geometry, mechanism.limbs, strict=True)):
        y_L, anchor = ca.SX(ca.DM(geometry.R_WL[:, 1])), ca.SX(ca.DM(geometry.base))
        # Offsets of the struts from their middle.
        sides = [-half * y_L, half * y_L] if geometry.struts > 1 else [ca.SX.zeros(3)]
        yield from _limb(robot, i, limb, sides)
        base += [anchor + side for side in sides]
        first = isinstance(robot.platform, RigidPlatform) or robot.platform.on_first(i)
        held.setdefault(first, []).extend(limb.held + side for side in sides)
    yield from _polygon(_BASE, base)
    for corners in held.values():
        yield from _polygon(robot.platform.bodies[0], corners)
    yield from _joining(robot, mechanism)
    yield from _telescope(mechanism)


def _drawn_by_user(robot: RobotDescription, mechanism: Mechanism) -> Iterator[Segment]:
    """Segments from the user's function, or a line from each body's frame to its prior's centre of
    mass."""
    if mechanism.drawing:
        yield from (Segment(*line) for line in mechanism.drawing)
        return
    for body in mechanism.bodies:
        p = robot.bodies[body.name].prior_parameters()
        centre = body.world_origin + body.world_rotation @ ca.DM(p[1:4] / p[0])
        yield Segment(body.name, body.world_origin, centre)


def drawn_spacing(robot: RobotDescription) -> float:
    """Distance between the two struts of a limb in drawings, where it is not described [m]."""
    return 0.5 * _size(robot)


def _size(robot: RobotDescription) -> float:
    """Radius of the platform, else of the base, else a fifth of a strut's length [m]."""
    limbs = robot.limb_geometry
    for points in ([l.attachment for l in limbs], [l.base for l in limbs]):
        radius = float(np.mean([np.linalg.norm(point) for point in points]))
        if radius > 0:
            return radius
    return 0.2 * limbs[0].strut


def _limb(
    robot: RobotDescription, i: int, limb: LimbBodies, sides: list[ca.SX]
) -> Iterator[Segment]:
    geometry, start = robot.limb_geometry[i], ca.SX(ca.DM(robot.limb_geometry[i].base))
    driven, strut, elbow = limb.driven.name, limb.strut.name, limb.strut.world_origin
    for side in sides:
        yield Segment(strut, elbow + side, limb.held + side)
    yield Segment(driven, elbow + sides[0], elbow + sides[-1])
    if geometry.drive == "rotary":
        yield Segment(driven, limb.driven.world_origin, elbow)
    else:
        rail = ca.SX(ca.DM(geometry.R_WL @ geometry.rail))
        low, high = robot.limits_of(f"drive{i + 1}").range or (-0.5, 0.5)
        yield Segment(_BASE, start + low * rail, start + high * rail)


def _joining(robot: RobotDescription, mechanism: Mechanism) -> list[Segment]:
    names = robot.platform.bodies
    if len(names) == 1:
        return []
    first, second, *_, tool = mechanism.platform
    pointer = tool.world_origin + max(0.5 * _size(robot), 0.03) * tool.world_rotation[:, 0]
    return [
        Segment(names[1] if len(names) == 3 else names[0], first.world_origin, second.world_origin),
        Segment("EE", tool.world_origin, pointer),
    ]


def _telescope(mechanism: Mechanism) -> list[Segment]:
    if not mechanism.telescope:
        return []
    top, bottom, tool = (part.world_origin for part in mechanism.telescope)
    middle = 0.5 * (top + bottom)
    return [
        Segment("TU", top, middle),
        Segment("TL", middle, bottom),
        Segment("EE", tool, tool + 0.05 * mechanism.telescope[-1].world_rotation[:, 0]),
    ]


def _polygon(body: str, corners: list[ca.SX]) -> list[Segment]:
    return [Segment(body, corners[i - 1], corners[i]) for i in range(len(corners))]
