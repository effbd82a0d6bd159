"""Figures of tracking: errors of platform and drives, torques, controllers beside each other."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float

from deltaid.control.comparison import ControllerRun
from deltaid.control.tracking import Tracking
from deltaid.dynamics.limits import effort_limits
from deltaid.robot.description import RobotDescription
from deltaid.view import style
from deltaid.view.comparison import peak_rows
from deltaid.view.page import Figure

NO_MODEL = "no model"
# Points a line is drawn with.
_POINTS = 4000
COLOURS = {
    "": style.LIMIT,
    "prior": style.PRIOR,
    "base parameters": style.MEASURED,
    "identified": style.IDENTIFIED,
}

Signal = Float[np.ndarray, " samples"]


def error_bars(runs: Sequence[ControllerRun]) -> Figure:
    """Error of the platform for each controller and model."""
    figure, models = go.Figure(), dict[str, dict[str, float]]()
    for run in runs:
        errors = models.setdefault(run.model, {})
        if run.tracking is not None:
            errors[run.controller] = 1e3 * run.tracking.error.platform_rms
    for model, errors in models.items():
        figure.add_bar(
            x=list(errors),
            y=list(errors.values()),
            name=model or NO_MODEL,
            marker={"color": COLOURS[model], "line": {"width": 0}},
            text=[f"{x:.2g}" if x < 99.5 else f"{x:.0f}" for x in errors.values()],
            textposition="outside",
            cliponaxis=False,
            hovertemplate="%{x}, " + (model or NO_MODEL) + ": %{y:.3g} mm<extra></extra>",
        )
    return Figure(
        figure.update_layout(
            yaxis={"type": "log", "title": "platform error, rms [mm]", "dtick": 1},
            barmode="group",
            height=420,
            bargap=0.25,
        ),
        "Distance of the platform point from where it should be, root mean square, with a "
        "logarithmic scale. All have the same tuning, so what differs is what they know of the "
        "robot.",
    )


def error_figures(runs: Sequence[tuple[str, str, Tracking]]) -> tuple[Figure, ...]:
    """Distance of the platform from where it should be, and error of the tool's turn, over time."""
    platform = [(name, color, run.time, 1e3 * run.platform_error) for name, color, run in runs]
    turns = [
        (name, color, run.time, np.rad2deg(run.turn_error))
        for name, color, run in runs
        if run.turn_error is not None
    ]
    where = "Distance of the platform point from where it should be."
    turned = "Turn ψ of the tool, actual less desired."
    return (
        _over_time(platform, "platform error", "mm", where),
        *([_over_time(turns, "error of the turn", "°", turned)] if turns else []),
    )


def _over_time(
    lines: Sequence[tuple[str, str, Signal, Signal]], what: str, unit: str, caption: str
) -> Figure:
    axis = {"title": f"{what} [{unit}]", "rangemode": "tozero"}
    figure = go.Figure(layout={"xaxis": {"title": "time [s]"}, "yaxis": axis, "height": 340})
    for name, color, time, error in lines:
        figure.add_scatter(
            **_peaks(time, error),
            name=style.label(name),
            mode="lines",
            line={"color": color, "width": 1.3},
            showlegend=len(lines) > 1,
            hovertemplate=f"%{{y:.3g}} {unit} at %{{x:.4g}} s<extra></extra>",
        )
    return Figure(figure, caption)


def shown_length(robot: RobotDescription, drive: str) -> tuple[str, float]:
    """The unit that errors of a drive are shown in, and how many of it are a rad or m."""
    return ("mm", 1e3) if robot.is_linear(drive) else ("°", np.rad2deg(1.0))


def drive_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """q − q_d of each drive."""
    units = [shown_length(robot, drive) for drive in robot.drives]
    figure = _stack(robot, [unit for unit, _ in units])
    for i, (drive, (unit, scale)) in enumerate(zip(robot.drives, units, strict=True)):
        error, hover = scale * result.drive_error[:, i], f"{drive} %{{y:.3g}} {unit}"
        _line(figure, i, result.time, error, style.RESIDUAL, hover)
    return Figure(figure, "Error of each drive, actual less desired coordinate.")


def torque_figure(robot: RobotDescription, result: Tracking) -> Figure:
    """Torques that were applied, with the drives' limits where they come near."""
    units = [robot.units(drive).force for drive in robot.drives]
    figure, line = _stack(robot, units), {"color": style.LIMIT, "dash": "dot", "width": 1}
    for i, limit in enumerate(effort_limits(robot)):
        tau, hover = result.tau[:, i], f"{robot.drives[i]} %{{y:.4g}} {units[i]}"
        _line(figure, i, result.time, tau, style.MEASURED, hover)
        if np.nanmax(np.abs(tau)) > 0.5 * limit:
            for edge in (-limit, limit):
                figure.add_hline(y=edge, line=line, row=i + 1, col=1)  # pyright: ignore[reportArgumentType]
    return Figure(figure, "Torques of the drives. Dotted: limits of the plant, if near.")


def _stack(robot: RobotDescription, units: Sequence[str]) -> go.Figure:
    titles = [f"{drive} [{unit}]" for drive, unit in zip(robot.drives, units, strict=True)]
    return style.stacked(titles, height=170 * len(titles) + 80, spacing=0.12 / len(titles))


def _line(figure: go.Figure, i: int, time: Signal, values: Signal, color: str, hover: str) -> None:
    figure.add_scatter(
        **_peaks(time, values),
        mode="lines",
        showlegend=False,
        line={"color": color, "width": 1.2},
        hovertemplate=hover + " at %{x:.4g} s<extra></extra>",
        row=i + 1,
        col=1,
    )


def _peaks(time: Signal, values: Signal) -> dict[str, Float[np.ndarray, " shown"]]:
    """At most `_POINTS` samples: of each stretch the one of largest size."""
    rows = peak_rows(np.abs(values), _POINTS)
    return {"x": time[rows].astype(np.float32), "y": values[rows].astype(np.float32)}
