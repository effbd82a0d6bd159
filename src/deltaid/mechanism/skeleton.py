"""A robot as line segments, to draw it: arms, both struts of each parallelogram, platform, bar.

Everything follows from the poses of the moving bodies, so what is drawn is what is computed with.
Only the distance between the two struts of a parallelogram is no number of the description, because
it changes no motion; it is drawn as `_APART` of the platform's or base's radius.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.robot.description import RobotDescription

_APART = 0.5
_BASE = "base"


@dataclass(frozen=True)
class Segment:
    """A straight part of a body: its two ends in the world [m], functions of z."""

    body: str
    start: ca.SX
    end: ca.SX


class Skeleton:
    """The segments of a robot, evaluated for many samples."""

    def __init__(self, robot: RobotDescription, mechanism: Mechanism) -> None:
        self.segments: tuple[Segment, ...] = tuple(_segments(robot, mechanism))
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


def _segments(robot: RobotDescription, mechanism: Mechanism) -> list[Segment]:
    radius = robot.limbs.platform_radius or robot.limbs.base_radius
    half = 0.5 * _APART * (radius or 0.2 * robot.limbs.upper_arm)
    named = {name: [b for b in mechanism.bodies if b.name == name] for name in ("U", "S", "P")}
    segments, base, platform = [], [], []
    for arm, strut in zip(named["U"], named["S"], strict=True):
        across = half * _rotation(arm)[:, 1] if strut.count > 1 else ca.SX.zeros(3)
        shoulder, elbow = _origin(arm), _origin(strut)
        foot = elbow + robot.limbs.strut * _rotation(strut)[:, 0]
        segments.append(Segment("U", shoulder, elbow))
        sides = (-across, across) if strut.count > 1 else (across,)
        segments += [Segment("S", elbow + side, foot + side) for side in sides]
        segments += [Segment("U", elbow - across, elbow + across)]
        base += [shoulder + side for side in sides]
        platform += [foot + side for side in sides]
    segments += _polygon(_BASE, base) + _polygon("P", platform)
    return segments + _telescope(mechanism, radius)


def _telescope(mechanism: Mechanism, radius: float) -> list[Segment]:
    """Upper and lower half of the bar, and the end effector's x axis, which turns with ψ."""
    parts = {body.name: body for body in mechanism.bodies}
    if not {"TU", "TL", "EE"} <= parts.keys():
        return []
    top, bottom, tool = (_origin(parts[name]) for name in ("TU", "TL", "EE"))
    middle = 0.5 * (top + bottom)
    pointer = tool + max(radius, 0.05) * _rotation(parts["EE"])[:, 0]
    return [
        Segment("TU", top, middle),
        Segment("TL", middle, bottom),
        Segment("EE", tool, pointer),
    ]


def _polygon(body: str, corners: list[ca.SX]) -> list[Segment]:
    return [Segment(body, corners[i - 1], corners[i]) for i in range(len(corners))]


def _rotation(body: MovingBody) -> ca.SX:
    return ca.SX(body.R_WL) @ body.R_LB


def _origin(body: MovingBody) -> ca.SX:
    return ca.SX(body.R_WL) @ body.r_LB
