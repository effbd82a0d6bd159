"""Figures of torques: measured and predicted over time, and four views of what is left."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from jaxtyping import Float
from plotly.subplots import make_subplots
from scipy import stats

from deltaid.robot.parameter import JointUnits
from deltaid.view import style
from deltaid.view.comparison import TorqueComparison
from deltaid.view.page import Figure
from deltaid.view.thinning import even_rows

# Intervals of speed, and of the residual.
_SPEED_BINS, _RESIDUAL_BINS = 30, 60
_SCATTER = 2500  # points a drive

Drives = dict[str, JointUnits]


def torque_blocks(comparison: TorqueComparison, drives: Drives) -> tuple[Figure, ...]:
    """All figures of one recording."""
    return (over_time(comparison, drives), *residual_blocks(comparison, drives))


def residual_blocks(comparison: TorqueComparison, drives: Drives) -> tuple[Figure, ...]:
    """What the model leaves of one recording, over speed, in size and in frequency."""
    return tuple(figure(comparison, drives) for figure in (over_speed, histogram, spectrum))


def over_time(c: TorqueComparison, drives: Drives) -> Figure:
    """Measured and predicted torque, and below each drive's the residual, with one time axis."""
    n = len(drives)
    figure = make_subplots(
        rows=2 * n,
        cols=1,
        shared_xaxes=True,
        row_heights=[2.2, 1.0] * n,
        vertical_spacing=0.22 / (2 * n),
    )
    time = _compact(c.time)
    for i, (drive, units) in enumerate(drives.items()):
        measured, predicted = c.measured[:, i], c.predicted[:, i]
        thin = {"color": style.RESIDUAL, "width": 1.0}
        for name, values, line, row in (
            ("measured", measured, style.MEASURED_LINE, 2 * i + 1),
            ("predicted", predicted, style.PREDICTED_LINE, 2 * i + 1),
            ("residual", measured - predicted, thin, 2 * i + 2),
        ):
            figure.add_scatter(
                x=time,
                y=values.astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=i == 0,
                mode="lines",
                line=line,
                hovertemplate=f"{drive} {name} %{{y:.4g}} {units.force} at %{{x:.4g}} s"
                "<extra></extra>",
                row=row,
                col=1,
            )
        if len(c.events):
            figure.add_scatter(
                x=np.insert(c.events, 2, np.nan, axis=1).ravel(),
                y=np.tile([0.0, 0.0, np.nan], len(c.events)),
                name="left out: events",
                legendgroup="events",
                showlegend=i == 0,
                mode="lines",
                line={"color": style.LIMIT, "width": 5},
                hovertemplate="excluded from here at %{x:.4g} s<extra></extra>",
                row=2 * i + 2,
                col=1,
            )
        figure.update_yaxes(title_text=f"{drive} [{units.force}]", row=2 * i + 1, col=1)
        figure.update_yaxes(title_text="residual", row=2 * i + 2, col=1)
    figure.update_xaxes(title_text="time [s]", row=2 * n, col=1)
    figure.update_layout(height=280 * n + 90, dragmode="zoom", hovermode="closest")
    shown = (
        "All samples at the rate that the filter's cut-off allows are drawn."
        if c.cutoff and c.stretch == 1
        else "All samples are drawn."
        if c.stretch == 1
        else f"Of every {c.stretch} samples the one with the largest residual is drawn."
    )
    filtered = f" after the low-pass of {c.cutoff:.3g} Hz" if c.cutoff else ""
    return Figure(
        figure,
        f"{_efforts(drives)} of each drive{filtered}, measured (broad line) and predicted by the "
        "model (dashed), and the residual (measured minus predicted). Drag to zoom; the time axes "
        "move together, a double "
        f"click shows everything again. {shown}",
        paper=640,
    )


def over_speed(c: TorqueComparison, drives: Drives) -> Figure:
    """Residual over the drive's speed: what friction leaves shows here."""
    figure = grid(tuple(drives), 260)
    keep = even_rows(len(c.speed), _SCATTER)
    for i, units in enumerate(drives.values()):
        row, col = i // 2 + 1, i % 2 + 1
        told = np.isfinite(c.residual[:, i])
        speed, residual = units.per_shown * c.speed[told, i], c.residual[told, i]
        figure.add_scatter(
            x=speed[keep].astype(np.float32),
            y=residual[keep].astype(np.float32),
            name="residual",
            legendgroup="residual",
            showlegend=i == 0,
            mode="markers",
            marker={"color": style.RESIDUAL, "size": 3, "opacity": 0.35},
            row=row,
            col=col,
        )
        centre, mean, spread = _binned(speed, residual)
        figure.add_scatter(
            x=centre,
            y=mean,
            error_y={"array": spread, "thickness": 1, "width": 2},
            name="mean and standard deviation",
            legendgroup="binned",
            showlegend=i == 0,
            mode="lines+markers",
            line={"color": style.LIMIT, "width": 1.5},
            marker={"size": 4},
            row=row,
            col=col,
        )
    _axes(figure, drives, "speed [{0.shown}/s]", "residual [{0.force}]")
    return Figure(
        figure,
        "Residual over the speed of its drive, with mean and standard deviation in intervals of "
        "speed. A mean that leaves zero is a friction law that does not fit.",
    )


def histogram(c: TorqueComparison, drives: Drives) -> Figure:
    """How residuals are distributed, against a normal distribution of equal spread."""
    figure = grid(tuple(drives), 260)
    for i in range(len(drives)):
        row, col = i // 2 + 1, i % 2 + 1
        residual = c.residual[np.isfinite(c.residual[:, i]), i]
        share, edges = np.histogram(residual, bins=_RESIDUAL_BINS, density=True)
        middle = 0.5 * (edges[1:] + edges[:-1])
        figure.add_bar(
            x=middle,
            y=share,
            width=np.diff(edges),
            name="residual",
            legendgroup="residual",
            showlegend=i == 0,
            marker={"color": style.RESIDUAL, "opacity": 0.7, "line": {"width": 0}},
            row=row,
            col=col,
        )
        figure.add_scatter(
            x=middle,
            y=stats.norm.pdf(middle, residual.mean(), max(float(residual.std()), 1e-300)),
            name="normal distribution",
            legendgroup="normal",
            showlegend=i == 0,
            mode="lines",
            line={"color": style.PRIOR, "width": 2},
            row=row,
            col=col,
        )
    _axes(figure, drives, "residual [{0.force}]", "density [1/({0.force})]")
    figure.update_layout(bargap=0)
    return Figure(
        figure,
        "Distribution of the residuals, and the normal distribution of the same mean and spread.",
    )


def spectrum(c: TorqueComparison, drives: Drives) -> Figure:
    """Amplitude spectra of the torque as recorded and of the residual."""
    figure = grid(tuple(drives), 260)
    for i in range(len(drives)):
        for name, density, color, dash in (
            ("measured", c.measured_density, style.MEASURED, "solid"),
            ("residual", c.residual_density, style.RESIDUAL, "dot"),
        ):
            figure.add_scatter(
                x=c.frequency.astype(np.float32),
                y=density[:, i].astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=i == 0,
                mode="lines",
                line={"color": color, "width": 1.4, "dash": dash},
                row=i // 2 + 1,
                col=i % 2 + 1,
            )
    if c.cutoff:
        figure.add_vline(x=c.cutoff, line={"color": style.PRIOR, "dash": "dot"})
    _axes(figure, drives, "frequency [Hz]", "density [{0.force}/√Hz]")
    figure.update_xaxes(type="log", dtick=1)
    figure.update_yaxes(type="log", dtick=1, exponentformat="power")
    dotted = f" The dotted line is the filter's cut-off of {c.cutoff:.3g} Hz." if c.cutoff else ""
    return Figure(
        figure,
        "Amplitude spectral density (Welch's mean over segments) of the "
        f"{_efforts(drives).lower()} as recorded, and of what the model does not explain of "
        f"it.{dotted}",
    )


def _compact(time: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
    """Times in single precision where that still tells samples apart, as seconds since 1970 do
    not."""
    resolution = float(np.spacing(np.float32(np.abs(time).max(initial=0.0))))
    fine = resolution < 0.05 * np.min(np.diff(time), initial=np.inf)
    return time.astype(np.float32) if fine else time


def _binned(speed: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, ...]:
    """Centres of speed intervals with enough samples, mean and standard deviation in each."""
    if not speed.size or np.ptp(speed) == 0:
        return speed[:0], speed[:0], speed[:0]
    mean, edges, _ = stats.binned_statistic(speed, residual, "mean", _SPEED_BINS)
    spread, *_ = stats.binned_statistic(speed, residual, "std", edges)
    count, *_ = stats.binned_statistic(speed, residual, "count", edges)
    enough = count >= 5
    return (0.5 * (edges[1:] + edges[:-1]))[enough], mean[enough], spread[enough]


def _efforts(drives: Drives) -> str:
    """'Torque', 'Force' or both, by what the drives give."""
    return " or ".join(dict.fromkeys(u.effort for u in drives.values())).capitalize()


def grid(names: Sequence[str], height: int) -> go.Figure:
    """A panel each, two in a row and so high [px], below the legend."""
    rows = -(-len(names) // 2)
    figure = make_subplots(
        rows=rows,
        cols=2,
        subplot_titles=names,
        horizontal_spacing=0.12,
        vertical_spacing=0.3 / rows,
    )
    figure.update_annotations(font_size=13)
    return figure.update_layout(
        height=height * rows + 100,
        margin={"t": 75},
        legend={"y": 1.0, "yanchor": "top", "yref": "container"},
    )


def _axes(figure: go.Figure, drives: Drives, x: str, y: str) -> None:
    """Titles with each drive's units, at the outer axes only where all drives have the same."""
    alike = len(set(drives.values())) == 1
    for i, units in enumerate(drives.values()):
        row, col = i // 2 + 1, i % 2 + 1
        if i + 2 >= len(drives) or not alike:
            figure.update_xaxes(title_text=x.format(units), row=row, col=col)
        if col == 1 or not alike:
            figure.update_yaxes(title_text=y.format(units), row=row, col=col)
