"""Picture data of a robot at a requested pose, computed in a separate process."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.limits import AtRest
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.model import load
from deltaid.view.at_pose import View, moved, standing
from deltaid.view.drawing import (
    DrawnBody,
    Placement,
    along,
    members,
    outline_points,
    outline_segments,
)
from deltaid.view.reach import require_space

# Range of requested poses beyond the workspace, as a share of it.
_BEYOND = 0.3


@dataclass(frozen=True)
class Axis:
    """A coordinate of the platform: its name, unit and range of requests."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Stage:
    """The static part of a robot's picture.

    Attributes:
        axes: of the platform, in the order of z; angles in degrees.
        bars: looks of the body of each segment.
        edges: of the workspace [m].
        size: of the robot at home [m].
        home: initial pose, in the units of the axes.
    """

    axes: tuple[Axis, ...]
    bars: tuple[DrawnBody, ...]
    edges: Float[np.ndarray, "edges 2 3"]
    size: float
    home: tuple[float, ...]


def stage(robot: str, changed: str) -> Stage:
    """The static part of a robot's picture.

    Args:
        robot: name or file.
        changed: differs whenever the file has changed.

    Raises:
        DeltaidError: the robot is invalid, cannot stand in its workspace, or moves in a plane only.
    """
    rest, skeleton = _built(robot, changed)
    size = float(np.ptp(skeleton.evaluate(rest.home[None]).reshape(-1, 3), axis=0).max())
    drawn = members(skeleton.bodies)
    return Stage(
        axes=_axes(rest),
        bars=tuple(drawn[segment.body] for segment in skeleton.segments),
        edges=outline_segments(rest.robot.workspace),
        size=size,
        home=tuple((rest.home * _units(rest)).tolist()),
    )


def robot_at(
    robot: str, changed: str, wanted: Sequence[float], before: Sequence[float]
) -> tuple[View, Placement]:
    """Readings of a robot at a pose, and the places of its segments; out of reach it keeps its last
    pose, with a message.

    Args:
        robot: name or file.
        changed: differs whenever the file has changed.
        wanted: requested pose in the units of the axes.
        before: last pose, in the same units.

    Raises:
        DeltaidError: as `stage`.
    """
    rest, skeleton = _built(robot, changed)
    units = _units(rest)
    view = moved(rest, standing(rest, rest.home), np.asarray(before, dtype=float) / units)
    view = moved(rest, view, np.asarray(wanted, dtype=float) / units)
    return view, along(skeleton.evaluate(view.z[None])[0], 1.0)


@lru_cache(2)
def _built(robot: str, _changed: str) -> tuple[AtRest, Skeleton]:
    model = load(robot)
    require_space(model.robot)
    rest = AtRest(model.dynamics, model.p)
    return rest, Skeleton(rest.robot, rest.dynamics.kinematics.mechanism)


def _units(rest: AtRest) -> Float[np.ndarray, " dof"]:
    """Factors from coordinates to displayed units: metres stay, radians become degrees."""
    return np.array([1.0, 1.0, 1.0, *(np.rad2deg(1.0) for _ in range(rest.dynamics.dof - 3))])


def _axes(rest: AtRest) -> tuple[Axis, ...]:
    edges = outline_points(rest.robot.workspace)
    low, high = edges.min(axis=0), edges.max(axis=0)
    beyond = _BEYOND * (high - low)
    ends = zip("xyz", (low - beyond).tolist(), (high + beyond).tolist(), strict=True)
    axes = [Axis(name, "m", *span) for name, *span in ends]
    if rest.dynamics.dof > 3:
        turn = rest.robot.turn
        axes.append(Axis("ψ", "deg", float(np.rad2deg(turn.low)), float(np.rad2deg(turn.high))))
    return tuple(axes)
