"""Figures of tracking: controllers side by side, and errors and torques over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from deltaid.control.comparison import ControllerRun
from deltaid.control.tracking import Tracking
from deltaid.dynamics.limits import effort_limits
from deltaid.grouping import grouped
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.comparison import POINTS, peak_rows
from deltaid.view.page import Figure

NO_MODEL = "no model"
# Colours by name of the model; other names are models with a known load.
_COLOURS = {
    "": style.LIMIT,
    "prior": style.PRIOR,
    "base parameters": style.MEASURED,
    "identified": style.IDENTIFIED,
}

Signal = Float[np.ndarray, " samples"]


def model_colour(model: str) -> str:
    """Colour of a controller's model by its name."""
    return _COLOURS.get(model, style.RESIDUAL)


def error_bars(runs: Sequence[ControllerRun]) -> Figure:
    axis = {"type": "log", "title": "platform error, rms [mm]", "dtick": 1}
    layout = {"yaxis": axis, "barmode": "group", "height": 420, "bargap": 0.25}
    figure = go.Figure(layout=layout)
    for model, of_model in grouped((run.model, run) for run in runs).items():
        errors = {
            run.controller: 1e3 * run.tracking.error.platform_rms
            for run in of_model
            if run.tracking is not None
        }
        figure.add_bar(
            x=list(errors),
            y=list(errors.values()),
            name=model or NO_MODEL,
            marker={"color": model_colour(model), "line": {"width": 0}},
            text=[f"{x:.2g}" if x < 99.5 else f"{x:.0f}" for x in errors.values()],
            textposition="outside",
            cliponaxis=False,
            hovertemplate="%{x}, " + (model or NO_MODEL) + ": %{y:.3g} mm<extra></extra>",
        )
    return Figure(
        figure,
        "Distance of the platform point from where it should be, root mean square, with a "
        "logarithmic scale. All have the same tuning, so what differs is what they know of the "
        "robot.",
    )


def error_figures(runs: Sequence[tuple[str, str, Tracking]]) -> tuple[Figure, ...]:
    """Distance of the platform from the desired motion, and error of the tool's turn, over time."""
    platform = [(name, color, run.time, 1e3 * run.platform_error) for name, color, run in runs]
    turns = [
        (name, color, run.time, np.rad2deg(run.turn_error))
        for name, color, run in runs
        if run.turn_error is not None
    ]
    where = "Distance of the platform point from where it should be."
    turned = "Turn ψ of the tool, actual less desired."
    return (
        _one_panel(platform, "platform error", "mm", where),
        *([_one_panel(turns, "error of the turn", "°", turned)] if turns else []),
    )


def _one_panel(
    lines: Sequence[tuple[str, str, Signal, Signal]], what: str, unit: str, caption: str
) -> Figure:
    axis = {"title": f"{what} [{unit}]", "rangemode": "tozero"}
    traces = [
        _peaks(
            time,
            error,
            {"color": color, "width": 1.3},
            f"%{{y:.3g}} {unit}",
            name=style.label(name),
            showlegend=len(lines) > 1,
        )
        for name, color, time, error in lines
    ]
    layout = {"xaxis": {"title": "time [s]"}, "yaxis": axis, "height": 340}
    return Figure(go.Figure(traces, layout), caption)


def drive_length(robot: RobotDescription, drive: str) -> tuple[str, float]:
    """Displayed unit of a drive's errors, and its number in a rad or m."""
    return ("mm", 1e3) if robot.is_linear(drive) else ("°", np.rad2deg(1.0))


def drive_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """Position error q − q_d of each drive."""
    units, scales = zip(*(drive_length(robot, drive) for drive in robot.drives), strict=True)
    errors = result.drive_error * np.array(scales)
    figure = _panel_per_drive(robot, units, result.time, errors, style.RESIDUAL, "%{y:.3g}")
    return Figure(figure, "Error of each drive, actual less desired coordinate.")


def torque_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """Applied torques, with the drives' limits if they come close."""
    units = [robot.units(drive).force for drive in robot.drives]
    figure = _panel_per_drive(robot, units, result.time, result.tau, style.MEASURED, "%{y:.4g}")
    line = {"color": style.LIMIT, "dash": "dot", "width": 1}
    for row, (limit, tau) in enumerate(zip(effort_limits(robot), result.tau.T, strict=True), 1):
        if np.nanmax(np.abs(tau)) > 0.5 * limit:
            for edge in (-limit, limit):
                figure.add_hline(y=edge, line=line, row=row, col=1)  # pyright: ignore[reportArgumentType]
    return Figure(figure, "Torques of the drives. Dotted: limits of the plant, if near.")


def _panel_per_drive(
    robot: RobotDescription,
    units: Sequence[str],
    time: Signal,
    values: Float[np.ndarray, "samples drives"],
    color: str,
    shown: str,
) -> go.Figure:
    titles = [f"{drive} [{unit}]" for drive, unit in zip(robot.drives, units, strict=True)]
    figure = style.stacked(titles, height=170 * len(titles) + 80, spacing=0.12 / len(titles))
    for row, (drive, unit) in enumerate(zip(robot.drives, units, strict=True), 1):
        line, hover = {"color": color, "width": 1.2}, f"{drive} {shown} {unit}"
        trace = _peaks(time, values[:, row - 1], line, hover, showlegend=False)
        figure.add_trace(trace, row=row, col=1)
    return figure


def _peaks(
    time: Signal, values: Signal, line: dict[str, Any], hover: str, **look: Any
) -> go.Scatter:
    """A line of at most `POINTS` samples: the largest in magnitude of each stretch."""
    rows = peak_rows(np.abs(values), POINTS)
    return go.Scatter(
        x=time[rows].astype(np.float32),
        y=values[rows].astype(np.float32),
        mode="lines",
        line=line,
        hovertemplate=f"{hover} at %{{x:.4g}} s<extra></extra>",
        **look,
    )
