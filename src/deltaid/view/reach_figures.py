"""Figures of a robot's reach: the region in three dimensions, and sections through it."""

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from plotly.subplots import make_subplots

from deltaid.dynamics.limits import AtRest
from deltaid.mechanism.skeleton import Skeleton
from deltaid.view import style
from deltaid.view.animation import fix_scene, robot_lines, still_line
from deltaid.view.drawing import outline, outline_points
from deltaid.view.page import Figure
from deltaid.view.reach import Reach, WorkspaceSurvey, bisected, limit_kinds, patches

# Points along each side of a section, for smooth contours within a second.
_GRID = 161
# Axes that the planes of the sections are normal to.
_NORMALS = (1, 0, 2)


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
        subplot_titles=[f"{'xyz'[k]} = {robot.home[k]:.3g} m" for k in _NORMALS],
        horizontal_spacing=0.09,
    )
    for column in range(1, 4):
        _add_section(figure, robot, column, low, high)
    largest = min(robot.robot.largest_condition, 1.5 * float(surveyed.poses.condition.max()))
    figure.update_layout(
        height=430,
        margin={"t": 40, "b": 90},
        coloraxis={
            "colorscale": "Viridis",
            "cmin": 1.0,
            "cmax": largest,
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


def _add_section(
    figure: go.Figure, robot: AtRest, column: int, low: np.ndarray, high: np.ndarray
) -> None:
    """Add a plane normal to an axis: condition, edge of the limits, edge of the workspace."""
    panel, normal = {"row": 1, "col": column}, _NORMALS[column - 1]
    i, j = (k for k in range(3) if k != normal)
    x, y = (np.linspace(low[k], high[k], _GRID) for k in (i, j))
    z = np.tile(robot.home, (_GRID**2, 1))
    z[:, i], z[:, j] = np.tile(x, _GRID), np.repeat(y, _GRID)
    axes = {"x": x.astype(np.float32), "y": y.astype(np.float32)}
    condition, use = _condition_and_use(robot, z)
    figure.add_heatmap(
        **axes,
        z=condition,
        coloraxis="coloraxis",
        hovertemplate=f"{'xyz'[i]} %{{x:.3f}} m, {'xyz'[j]} %{{y:.3f}} m: "
        "condition %{z:.3g}<extra></extra>",
        **panel,
    )
    figure.add_contour(
        **axes,
        z=use,
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
    along_x, along_y = ({"title_text": f"{'xyz'[k]} [m]"} for k in (i, j))
    figure.update_xaxes(along_x | {"constrain": "domain", "nticks": 5}, **panel)
    same = f"x{column if column > 1 else ''}"
    figure.update_yaxes(along_y | {"scaleanchor": same, "constrain": "domain"}, **panel)


def _condition_and_use(
    robot: AtRest, z: Float[np.ndarray, "points dof"]
) -> list[Float[np.ndarray, "grid grid"]]:
    """Condition, NaN out of reach, and largest use of a limit, which out of reach counts as twice
    the limit, because contours need numbers everywhere."""
    poses, largest = robot(z), robot.robot.largest_condition
    use = np.max(poses.shares[:, robot.of_workspace :], axis=1, initial=0.0)
    use = np.where(poses.stands, np.minimum(use, 2.0), 2.0)
    condition = np.where(poses.stands, np.minimum(poses.condition, largest), np.nan)
    return [values.reshape(_GRID, _GRID).astype(np.float32) for values in (condition, use)]


def _section(robot: AtRest, i: int, j: int) -> Float[np.ndarray, "points 2"]:
    """Edge of the workspace, which is convex, in the plane of two axes through home."""
    angle, home, space = np.linspace(0, 2 * np.pi, 361), robot.home[:3], robot.robot.workspace
    unit, low = np.zeros((len(angle), 3)), np.zeros(len(angle))
    unit[:, i], unit[:, j] = np.cos(angle), np.sin(angle)
    high = np.full(len(angle), np.ptp(outline_points(space), axis=0).sum())
    low = bisected(lambda way: space.contains(home + way[:, None] * unit), low, high, 40)
    return (home + low[:, None] * unit)[:, [i, j]].astype(np.float32)
