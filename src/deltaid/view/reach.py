"""Reach of a robot from its home pose and the limits that bound it, the reachable region, and
sections through it."""

import itertools
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Bool, Float, Int
from plotly.subplots import make_subplots
from scipy.stats import qmc

from deltaid.dynamics.limits import AtRest, Poses, kind_of_limit
from deltaid.errors import KinematicsError
from deltaid.mechanism.skeleton import Skeleton
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.animation import fix_scene, robot_lines, still_line
from deltaid.view.drawing import outline, outline_points
from deltaid.view.page import Figure

# Angle between directions of the rays [deg].
_EVERY = 4
# Steps of a ray over the largest possible reach, so that gaps shorter than a step are missed;
# number of bisections, which locate its end within micrometres.
_STEPS, _HALVINGS = 300, 20
# Points along each side of a section, for smooth contours within a second.
_GRID = 161
NOTHING = "nothing"


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
    poses = robot(inside[robot.robot.workspace.contains(inside[:, :3])])
    extremes = robot(edges)
    parts = extremes.only(extremes.stands), poses.only(poses.stands)
    names = Poses.__dataclass_fields__
    return WorkspaceSurvey(
        poses=Poses(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names}),
        standing=float(np.mean(poses.stands)),
        within=float(np.mean(good(robot, poses))),
    )


def good(robot: AtRest, poses: Poses) -> Bool[np.ndarray, " samples"]:
    """Which poses exist and keep the machine's own limits."""
    return poses.stands & np.all(poses.shares[:, robot.of_workspace :] <= 1, axis=1)


def _ends(
    robot: AtRest, directions: Float[np.ndarray, "rays dof"], longest: float
) -> tuple[Float[np.ndarray, " rays"], Int[np.ndarray, " rays"]]:

    def kept(distance: Float[np.ndarray, " some"], rays: np.ndarray) -> Bool[np.ndarray, " some"]:
        return good(robot, robot(robot.home + distance[:, None] * directions[rays]))

    everyone, low, step = np.arange(len(directions)), np.zeros(len(directions)), longest / _STEPS
    starting = kept(low, everyone)
    going = everyone[starting]
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


def picture(robot: AtRest, reached: Reach) -> Figure:
    """The robot at home, the described workspace, and the region it reaches."""
    skeleton = Skeleton(robot.robot, robot.dynamics.kinematics.mechanism)
    shape, space = skeleton.evaluate(robot.home[None])[0], robot.robot.workspace
    edges = still_line("workspace", outline(space), {"color": style.MEASURED, "width": 3})
    figure, colors = go.Figure([*robot_lines(skeleton, shape).values(), edges]), limit_kinds(robot)
    for name, (points, faces) in patches(robot, reached).items():
        figure.add_mesh3d(
            **dict(zip("xyz", points.astype(np.float32).T, strict=True)),
            **dict(zip("ijk", faces.astype(np.int32).T, strict=True)),
            name=f"ends at: {name}",
            color=colors[name],
            opacity=0.3,
            flatshading=True,
            showlegend=True,
            hovertemplate=f"ends at: {name}<br>%{{x:.3f}}, %{{y:.3f}}, %{{z:.3f}} m<extra></extra>",
        )
    drawn = shape.reshape(-1, 3), reached.points.reshape(-1, 3), outline_points(space)
    fix_scene(figure, *drawn, height=680, below=0)
    return Figure(
        figure.update_layout(margin={"t": 90}),
        "The robot at its home pose in the middle of the workspace. The surface is where straight "
        "ways from home end, coloured by the kind of limit that ends them; speeds are no part of "
        "it. Drag to turn the view; click on the legend to hide a part. The distance of the two "
        "struts in a pair is not part of the description and drawn as it looks usual.",
    )


def sections(robot: AtRest, reached: Reach, surveyed: WorkspaceSurvey) -> Figure:
    """Condition and use of limits in two vertical planes and a horizontal one through home."""
    points = np.concatenate([reached.points.reshape(-1, 3), outline_points(robot.robot.workspace)])
    low, high = points.min(axis=0), points.max(axis=0)
    low, high = low - 0.06 * (high - low), high + 0.06 * (high - low)
    figure = make_subplots(
        rows=1,
        cols=3,
        subplot_titles=[f"{'xyz'[k]} = {robot.home[k]:.3g} m" for k in (1, 0, 2)],
        horizontal_spacing=0.09,
    )
    largest = robot.robot.largest_condition
    for column, normal in enumerate((1, 0, 2), 1):
        panel, (i, j) = {"row": 1, "col": column}, (k for k in range(3) if k != normal)
        x, y = (np.linspace(low[k], high[k], _GRID) for k in (i, j))
        z = np.tile(robot.home, (_GRID**2, 1))
        z[:, i], z[:, j] = np.tile(x, _GRID), np.repeat(y, _GRID)
        poses = robot(z)
        use = np.max(poses.shares[:, robot.of_workspace :], axis=1, initial=0.0)
        # Out of reach counts as twice the limit, because contours need numbers everywhere.
        use = np.where(poses.stands, np.minimum(use, 2.0), 2.0)
        condition = np.where(poses.stands, np.minimum(poses.condition, largest), np.nan)
        shown = [values.reshape(_GRID, _GRID).astype(np.float32) for values in (condition, use)]
        axes = {"x": x.astype(np.float32), "y": y.astype(np.float32)}
        figure.add_heatmap(
            **axes,
            z=shown[0],
            coloraxis="coloraxis",
            hovertemplate=f"{'xyz'[i]} %{{x:.3f}} m, {'xyz'[j]} %{{y:.3f}} m: "
            "condition %{z:.3g}<extra></extra>",
            **panel,
        )
        figure.add_contour(
            **axes,
            z=shown[1],
            contours={"start": 1.0, "end": 1.0, "size": 1.0, "coloring": "none"},
            line={"color": style.LIMIT, "width": 2.5},
            name="limits",
            showlegend=False,
            showscale=False,
            hoverinfo="skip",
            **panel,
        )
        figure.add_scatter(
            **dict(zip("xy", _section(robot, i, j).T, strict=True)),
            mode="lines",
            line={"color": style.PRIOR, "width": 2, "dash": "dot"},
            showlegend=False,
            hoverinfo="skip",
            **panel,
        )
        x, y = ({"title_text": f"{'xyz'[k]} [m]"} for k in (i, j))
        figure.update_xaxes(x | {"constrain": "domain", "nticks": 5}, **panel)
        same = f"x{column if column > 1 else ''}"
        figure.update_yaxes(y | {"scaleanchor": same, "constrain": "domain"}, **panel)
    figure.update_layout(
        height=430,
        margin={"t": 40, "b": 90},
        coloraxis={
            "colorscale": "Viridis",
            "cmin": 1.0,
            "cmax": min(largest, 1.5 * float(surveyed.poses.condition.max())),
            "colorbar": {
                "orientation": "h",
                "y": -0.22,
                "yanchor": "top",
                "thickness": 10,
                "title": {"text": "condition", "side": "top"},
            },
        },
    )
    return Figure(
        figure,
        "Condition of the Jacobian in planes through the home pose; empty where the robot cannot "
        "stand. Within the line all limits of the machine at rest are kept; dotted is the "
        "described workspace.",
    )


def _section(robot: AtRest, i: int, j: int) -> Float[np.ndarray, "points 2"]:
    """Edge of the workspace in the plane of two axes through home, found along rays."""
    angle = np.linspace(0, 2 * np.pi, 361)
    unit, low = np.zeros((len(angle), 3)), np.zeros(len(angle))
    unit[:, i], unit[:, j] = np.cos(angle), np.sin(angle)
    high = np.full(len(angle), np.ptp(outline_points(robot.robot.workspace), axis=0).sum())
    for _ in range(40):  # workspaces are convex and contain home
        middle = 0.5 * (low + high)
        inside = robot.robot.workspace.contains(robot.home[:3] + middle[:, None] * unit)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return (robot.home[:3] + low[:, None] * unit)[:, [i, j]].astype(np.float32)
