"""Reach of a robot from its home pose and the limits that bound it, and the reachable region."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import qmc

from deltaid.dynamics.limits import AtRest, Poses, kind_of_limit
from deltaid.errors import KinematicsError
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.drawing import outline_points

# Angle between directions of the rays [deg].
_EVERY = 4
# Steps of a ray over the largest possible reach, so that gaps shorter than a step are missed;
# number of bisections, which locate its end within micrometres.
_STEPS, _HALVINGS = 300, 20
NOTHING = "nothing"
Rays = Float[np.ndarray, " rays"]
Inside = Bool[np.ndarray, " rays"]


@dataclass(frozen=True)
class Reach:
    """Ends of straight rays from the home pose at constant tool angle.

    Rows are polar angles from world z down (0 … π), columns azimuths (0 … 2 π, both ends).

    Attributes:
        home: start of all rays, z.
        points: their ends in the world [m].
        distance: their lengths [m].
        ended_by: index of the limit in `AtRest.limits` that ends each; −1 if none does within the
            robot's own lengths.
        volume: between home and the ends [m³].
        shares: share of all directions, by solid angle, that each limit ends; by its index.
        turn: lowest and highest tool angle at home [rad], with the limits that end it (−1: none);
            None without a tool that turns.
    """

    home: Float[np.ndarray, " dof"]
    points: Float[np.ndarray, "polar azimuth 3"]
    distance: Float[np.ndarray, "polar azimuth"]
    ended_by: Int[np.ndarray, "polar azimuth"]
    volume: float
    shares: dict[int, float]
    turn: tuple[tuple[float, int], tuple[float, int]] | None


@dataclass(frozen=True)
class WorkspaceSurvey:
    """Poses in the workspace, at all angles of the tool, with the use of limits.

    Attributes:
        poses: those where the robot can stand.
        standing: share of the workspace where the robot can stand.
        within: share of the workspace where it keeps all its limits.
    """

    poses: Poses
    standing: float
    within: float


def require_space(robot: RobotDescription) -> None:
    """Refuse a robot that does not move along x, y and z.

    Raises:
        KinematicsError: it moves along other coordinates only.
    """
    if len(robot.task.axes) < 3:
        raise KinematicsError(
            f"moves along {' and '.join(robot.task.names)} only",
            where=robot.name,
            cure="what a robot can reach is shown of those that move along x, y and z",
        )


def reach(robot: AtRest) -> Reach:
    """Ends of rays in all directions, within the machine's own limits.

    Distances are found by steps and then by bisection. The result describes the whole region if
    every point is on a free straight line from home, as for the usual Deltas.
    """
    polar, azimuth = np.meshgrid(
        *(np.deg2rad(np.arange(0, end + 1, _EVERY)) for end in (180, 360)), indexing="ij"
    )
    across = np.sin(polar)
    unit = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)], axis=-1)
    directions = np.zeros((polar.size, robot.dynamics.dof))
    directions[:, :3] = unit.reshape(-1, 3)
    ends = _ends(robot, directions, _longest(robot))
    distance, ended_by = (values.reshape(polar.shape) for values in ends)
    solid = across[:, :-1] * np.deg2rad(_EVERY) ** 2
    by_limit = np.bincount(ended_by[:, :-1].ravel() + 1, weights=solid.ravel())
    return Reach(
        home=robot.home,
        points=robot.home[:3] + distance[..., None] * unit,
        distance=distance,
        ended_by=ended_by,
        volume=float(np.sum(solid * distance[:, :-1] ** 3) / 3),
        shares={i - 1: float(w / solid.sum()) for i, w in enumerate(by_limit) if w > 0},
        turn=_turn(robot),
    )


def survey(robot: AtRest) -> WorkspaceSurvey:
    """Poses spread evenly over the workspace, and along its edges, where extremes occur."""
    edges, turn = outline_points(robot.robot.workspace), robot.robot.turn
    box = np.stack([edges.min(axis=0), edges.max(axis=0)])
    if robot.dynamics.dof > 3:  # at home and at both ends of the tool's range
        box = np.column_stack([box, [turn.low, turn.high]])
        angles = (robot.home[3], turn.low, turn.high)
        edges = np.concatenate([np.insert(edges, 3, angle, axis=1) for angle in angles])
    inside = qmc.scale(qmc.Sobol(len(box[0]), scramble=False).random(2**14), *box)
    inside = inside[robot.robot.workspace.contains(inside[:, :3])]
    poses, even = robot(np.concatenate([edges, inside])), slice(len(edges), None)
    return WorkspaceSurvey(
        poses=poses.only(poses.stands),
        standing=float(np.mean(poses.stands[even])),
        within=float(np.mean(good(robot, poses)[even])),
    )


def good(robot: AtRest, poses: Poses) -> Bool[np.ndarray, " samples"]:
    """Which poses exist and keep the machine's own limits."""
    return poses.stands & np.all(poses.shares[:, robot.of_workspace :] <= 1, axis=1)


def _ends(
    robot: AtRest, directions: Float[np.ndarray, "rays dof"], longest: float
) -> tuple[Float[np.ndarray, " rays"], Int[np.ndarray, " rays"]]:

    def are_good(
        distance: Float[np.ndarray, " some"], rays: np.ndarray
    ) -> Bool[np.ndarray, " some"]:
        return good(robot, robot(robot.home + distance[:, None] * directions[rays]))

    everyone, low, step = np.arange(len(directions)), np.zeros(len(directions)), longest / _STEPS
    starting = are_good(low, everyone)
    going = everyone[starting]
    for k in range(1, _STEPS + 1):
        going = going[are_good(np.full(len(going), k * step), going)]
        low[going] = k * step
    endless = np.isin(everyone, going)
    high = np.where(starting & ~endless, low + step, low)
    low = bisected(lambda distance: are_good(distance, everyone), low, high, _HALVINGS)
    shares = robot(robot.home + low[:, None] * directions).shares[:, robot.of_workspace :]
    return low, np.where(endless, -1, robot.of_workspace + np.argmax(shares, axis=1))


def _longest(robot: AtRest) -> float:
    """Upper bound of the reach [m]; without limbs, a multiple of home's distance."""
    spans, home = [], np.linalg.norm(robot.home[:3])
    for i, limb in enumerate(robot.robot.limb_geometry, 1):
        ends = robot.robot.limits_of(f"drive{i}").range
        rail = float(np.abs(ends).max()) if ends else 1.0
        drive = limb.upper_arm if limb.drive == "rotary" else rail
        spans.append(np.linalg.norm(limb.base) + drive + limb.strut)
    return float(min(spans, default=3.0 * home) + home)


def _turn(robot: AtRest) -> tuple[tuple[float, int], tuple[float, int]] | None:
    if robot.dynamics.dof < 4:
        return None
    turn, home = robot.robot.turn, float(robot.home[3])
    directions = np.array([[0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 1.0]])
    angle, ended_by = _ends(robot, directions, 1.01 * max(home - turn.low, turn.high - home))
    return (home - float(angle[0]), int(ended_by[0])), (home + float(angle[1]), int(ended_by[1]))


def limit_kinds(robot: AtRest) -> dict[str, str]:
    """Colours of the machine's own limits by kind, the same in all views."""
    kinds = dict.fromkeys(kind_of_limit(name) for name in robot.limits[robot.of_workspace :])
    colors = itertools.cycle([style.SERIES[k] for k in (3, 4, 2, 1, 0)])
    return dict(zip(kinds, colors, strict=False)) | {NOTHING: style.PRIOR}


def patches(
    robot: AtRest, reached: Reach
) -> dict[str, tuple[Float[np.ndarray, "points 3"], np.ndarray]]:
    """Corners and triangles of the region's surface, by the kind of limit that bounds it."""
    corner = np.arange(reached.distance.size).reshape(reached.distance.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.stack([np.stack([a, b, c]), np.stack([a, c, d])]).reshape(2, 3, -1)
    faces = faces.transpose(0, 2, 1).reshape(-1, 3)
    names = np.array(
        [*(kind_of_limit(name) for name in robot.limits), NOTHING]
    )  # index −1 selects the last
    ended_by = names[reached.ended_by.ravel()[faces[:, 0]]]
    points = reached.points.reshape(-1, 3)
    return {name: (points, faces[ended_by == name]) for name in np.unique(ended_by)}


def bisected(inside: Callable[[Rays], Inside], low: Rays, high: Rays, halvings: int) -> Rays:
    """Largest distances along rays, between two bounds, at which they are still inside."""
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        is_inside = inside(middle)
        low, high = np.where(is_inside, middle, low), np.where(is_inside, high, middle)
    return low
