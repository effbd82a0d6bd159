"""The robot in its reachable region, and sections through that region, as figures."""

import itertools

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from plotly.subplots import make_subplots

from deltaid.dynamics.at_rest import AtRest
from deltaid.mechanism.skeleton import Skeleton
from deltaid.view import style
from deltaid.view.animation import fix_scene, robot_lines, workspace_line
from deltaid.view.drawing import outline_points
from deltaid.view.page import Figure
from deltaid.view.reach import Reach, WorkspaceSurvey, kind

# Points along each side of a section: a contour without visible corners, in a second.
_GRID = 161
NOTHING = "nothing"


def limit_kinds(robot: AtRest) -> dict[str, str]:
    """A colour for each kind of the machine's own limits, the same in all views."""
    kinds = dict.fromkeys(kind(name) for name in robot.limits[robot.of_workspace :])
    colors = itertools.cycle([style.SERIES[k] for k in (3, 4, 2, 1, 0)])
    return dict(zip(kinds, colors, strict=False)) | {NOTHING: style.PRIOR}


def patches(
    robot: AtRest, found: Reach
) -> dict[str, tuple[Float[np.ndarray, "points 3"], np.ndarray]]:
    """Corners and triangles of the region's surface by the kind of limit that ends it there."""
    rows, columns = found.distance.shape
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.stack([np.stack([a, b, c]), np.stack([a, c, d])]).reshape(2, 3, -1)
    faces = faces.transpose(0, 2, 1).reshape(-1, 3)
    names = np.array([*(kind(name) for name in robot.limits), NOTHING])  # −1 is the last
    ended_by = names[found.ended_by.ravel()[faces[:, 0]]]
    return {
        name: (found.points.reshape(-1, 3), faces[ended_by == name]) for name in np.unique(ended_by)
    }


def picture(robot: AtRest, found: Reach) -> Figure:
    """The robot at home, the described workspace, and the region it reaches."""
    skeleton = Skeleton(robot.robot, robot.dynamics.kinematics.mechanism)
    shape = skeleton.evaluate(robot.home[None])[0]
    space = robot.robot.workspace
    edges = workspace_line(space, {"color": style.MEASURED, "width": 3})
    figure = go.Figure([*robot_lines(skeleton, shape).values(), edges])
    colors = limit_kinds(robot)
    for name, (points, faces) in patches(robot, found).items():
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
    drawn = shape.reshape(-1, 3), found.points.reshape(-1, 3), outline_points(space)
    fix_scene(figure, *drawn, height=680, below=0)
    figure.update_layout(margin={"t": 90})
    return Figure(
        figure,
        "The robot at its home pose in the middle of the workspace. The surface is where straight "
        "ways from home end, coloured by the kind of limit that ends them; speeds are no part of "
        "it. Drag to turn the view; click on the legend to hide a part. The distance of the two "
        "struts in a pair is not part of the description and drawn as it looks usual.",
    )


def sections(robot: AtRest, found: Reach, surveyed: WorkspaceSurvey) -> Figure:
    """Condition in two vertical planes and a horizontal one through home."""
    edges = outline_points(robot.robot.workspace)
    points = np.concatenate([found.points.reshape(-1, 3), edges])
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
        i, j = (k for k in range(3) if k != normal)
        x, y = (np.linspace(low[k], high[k], _GRID) for k in (i, j))
        z = np.tile(robot.home, (_GRID**2, 1))
        z[:, i], z[:, j] = np.tile(x, _GRID), np.repeat(y, _GRID)
        poses = robot(z)
        use = np.max(poses.shares[:, robot.of_workspace :], axis=1, initial=0.0)
        # Out of reach counts as twice the limit; what a contour needs are numbers without gaps.
        use = np.where(poses.stands, np.minimum(use, 2.0), 2.0).reshape(_GRID, _GRID)
        condition = np.where(poses.stands, np.minimum(poses.condition, largest), np.nan)
        axes = {"x": x.astype(np.float32), "y": y.astype(np.float32)}
        figure.add_heatmap(
            **axes,
            z=condition.reshape(_GRID, _GRID).astype(np.float32),
            coloraxis="coloraxis",
            hovertemplate=f"{'xyz'[i]} %{{x:.3f}} m, {'xyz'[j]} %{{y:.3f}} m: "
            "condition %{z:.3g}<extra></extra>",
            row=1,
            col=column,
        )
        figure.add_contour(
            **axes,
            z=use.astype(np.float32),
            contours={"start": 1.0, "end": 1.0, "size": 1.0, "coloring": "none"},
            line={"color": style.LIMIT, "width": 2.5},
            name="limits",
            showlegend=False,
            showscale=False,
            hoverinfo="skip",
            row=1,
            col=column,
        )
        figure.add_scatter(
            **dict(zip("xy", _section(robot, normal).T, strict=True)),
            mode="lines",
            line={"color": style.PRIOR, "width": 2, "dash": "dot"},
            showlegend=False,
            hoverinfo="skip",
            row=1,
            col=column,
        )
        figure.update_xaxes(
            title_text=f"{'xyz'[i]} [m]", row=1, col=column, constrain="domain", nticks=5
        )
        figure.update_yaxes(
            title_text=f"{'xyz'[j]} [m]",
            row=1,
            col=column,
            scaleanchor=f"x{column if column > 1 else ''}",
            constrain="domain",
        )
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


def _section(robot: AtRest, normal: int) -> Float[np.ndarray, "points 2"]:
    """Edge of the workspace in a plane through home, found along rays in that plane."""
    i, j = (k for k in range(3) if k != normal)
    angle = np.linspace(0, 2 * np.pi, 361)
    unit = np.zeros((len(angle), 3))
    unit[:, i], unit[:, j] = np.cos(angle), np.sin(angle)
    edges = outline_points(robot.robot.workspace)
    low, high = np.zeros(len(angle)), np.full(len(angle), np.ptp(edges, axis=0).sum())
    for _ in range(40):  # every workspace is convex, and home lies inside
        middle = 0.5 * (low + high)
        inside = robot.robot.workspace.contains(robot.home[:3] + middle[:, None] * unit)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return (robot.home[:3] + low[:, None] * unit)[:, [i, j]].astype(np.float32)
