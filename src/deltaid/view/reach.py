"""How far a robot can go from its home pose, and which limit ends its way in each direction."""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import qmc

from deltaid.dynamics.at_rest import AtRest, Poses
from deltaid.errors import KinematicsError
from deltaid.robot.description import RobotDescription
from deltaid.view.drawing import outline_points

# Directions of the rays: one every so many degrees.
_EVERY = 4
# Steps of a ray, as a share of the longest way that the lengths of the robot leave; gaps between
# two limits that are narrower are jumped over. Halvings then find the end within micrometres.
_STEPS, _HALVINGS = 300, 20
# Points inside the workspace that are looked at.
_POINTS = 2**14


@dataclass(frozen=True)
class Reach:
    """Ends of straight ways from the home pose, the tool's angle kept.

    Rows are polar angles from world z down (0 … π), columns azimuths (0 … 2 π, both ends).

    Attributes:
        home: where all ways begin, z.
        points: their ends in the world [m].
        distance: their lengths [m].
        ended_by: number of the limit of `AtRest.limits` that ends each; −1 where none does within
            the robot's own lengths.
        volume: of what lies between home and the ends [m³].
        shares: share of all directions, by solid angle, that each limit ends; by its number.
        turn: lowest and highest tool angle at home [rad], and the limits that end it (−1: none);
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
    """What a robot needs within its workspace, at all angles of its tool.

    Attributes:
        poses: those of the workspace where the robot can stand.
        standing: share of the workspace where it can stand.
        within: share of the workspace where it keeps all its limits.
    """

    poses: Poses
    standing: float
    within: float


def require_space(robot: RobotDescription) -> None:
    """Refuse a robot that does not move along x, y and z.

    Raises:
        KinematicsError: with what it moves along.
    """
    if len(robot.task.axes) < 3:
        raise KinematicsError(
            f"moves along {' and '.join(robot.task.names)} only",
            where=robot.name,
            cure="what a robot can reach is shown of those that move along x, y and z",
        )


def reach(robot: AtRest) -> Reach:
    """Ends of the ways in all directions that keep the machine's own limits.

    Distances are found by steps and then by halving. The region is described wholly where straight
    ways from home lead everywhere, which is so for the usual Deltas.
    """
    polar = np.deg2rad(np.arange(0, 181, _EVERY))[:, None]
    azimuth = np.deg2rad(np.arange(0, 361, _EVERY))[None, :]
    shape = np.broadcast_shapes(polar.shape, azimuth.shape)
    across = np.sin(polar)
    unit = np.stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), np.broadcast_to(np.cos(polar), shape)],
        axis=-1,
    )
    directions = np.zeros((unit[..., 0].size, robot.dynamics.dof))
    directions[:, :3] = unit.reshape(-1, 3)
    distance, ended_by = _ends(robot, directions, _longest(robot))
    distance, ended_by = distance.reshape(shape), ended_by.reshape(shape)
    solid = np.broadcast_to(across, shape)[:, :-1] * np.deg2rad(_EVERY) ** 2
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
    """Poses spread evenly over the workspace, and along its edges, where extremes are."""
    edges = outline_points(robot.robot.workspace)
    box = np.stack([edges.min(axis=0), edges.max(axis=0)])
    turn = robot.robot.turn
    if robot.dynamics.dof > 3:
        box = np.column_stack([box, [turn.low, turn.high]])
    inside = qmc.scale(qmc.Sobol(len(box[0]), scramble=False).random(_POINTS), *box)
    inside = inside[robot.robot.workspace.contains(inside[:, :3])]
    if robot.dynamics.dof > 3:  # at home and at either end of the tool's range
        angles = (robot.home[3], turn.low, turn.high)
        edges = np.concatenate([np.insert(edges, 3, angle, axis=1) for angle in angles])
    poses, extremes = robot(inside), robot(edges)
    parts = extremes.only(extremes.stands), poses.only(poses.stands)
    names = Poses.__dataclass_fields__
    return WorkspaceSurvey(
        poses=Poses(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names}),
        standing=float(np.mean(poses.stands)),
        within=float(np.mean(good(robot, poses))),
    )


def kind(limit: str) -> str:
    """Name of a limit without the number of its drive or strut."""
    return " ".join(re.sub(r"\d+", "", limit).split())


def good(robot: AtRest, poses: Poses) -> Bool[np.ndarray, " samples"]:
    """Which poses exist and keep the machine's own limits."""
    return poses.stands & np.all(poses.shares[:, robot.of_workspace :] <= 1, axis=1)


def _ends(
    robot: AtRest, directions: Float[np.ndarray, "rays dof"], longest: float
) -> tuple[Float[np.ndarray, " rays"], Int[np.ndarray, " rays"]]:

    def kept(distance: Float[np.ndarray, " some"], rays: np.ndarray) -> Bool[np.ndarray, " some"]:
        return good(robot, robot(robot.home + distance[:, None] * directions[rays]))

    everyone, step = np.arange(len(directions)), longest / _STEPS
    low = np.zeros(len(directions))
    going = everyone[kept(low, everyone)]
    starting = np.isin(everyone, going)
    for k in range(1, _STEPS + 1):
        going = going[kept(np.full(len(going), k * step), going)]
        low[going] = k * step
    endless = np.isin(everyone, going)
    high = np.where(starting & ~endless, low + step, low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = kept(middle, everyone)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    shares = robot(robot.home + low[:, None] * directions).shares[:, robot.of_workspace :]
    return low, np.where(endless, -1, robot.of_workspace + np.argmax(shares, axis=1))


def _longest(robot: AtRest) -> float:
    """No way within reach is longer [m]."""
    spans = []
    for i, limb in enumerate(robot.robot.limb_geometry):
        ends = robot.robot.limits_of(f"drive{i + 1}").range
        rail = float(np.abs(ends).max()) if ends else 1.0
        drive = limb.upper_arm if limb.drive == "rotary" else rail
        spans.append(np.linalg.norm(limb.base) + drive + limb.strut)
    own = 3.0 * np.linalg.norm(robot.home[:3])  # of a mechanism without limbs nothing is known
    return float(min(spans, default=own) + np.linalg.norm(robot.home[:3]))


def _turn(robot: AtRest) -> tuple[tuple[float, int], tuple[float, int]] | None:
    if robot.dynamics.dof < 4:
        return None
    turn, home = robot.robot.turn, float(robot.home[3])
    directions = np.zeros((2, 4))
    directions[:, 3] = -1.0, 1.0
    angle, ended_by = _ends(robot, directions, 1.01 * max(home - turn.low, turn.high - home))
    return (home - float(angle[0]), int(ended_by[0])), (home + float(angle[1]), int(ended_by[1]))
