"""Figures of torques: measured and predicted over time, and four views of the residual."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import stats

from deltaid.view import style
from deltaid.view.comparison import POINTS, TorqueComparison, even_rows
from deltaid.view.page import Figure


def residual_blocks(compared: TorqueComparison) -> tuple[Figure, ...]:
    return tuple(figure(compared) for figure in (_over_speed, _histogram, _spectrum))


def over_time(compared: TorqueComparison) -> Figure:
    """Measured and predicted torque, with the residual below each, over one time axis."""
    n = len(compared.drives)
    figure = style.stacked(
        [t for drive, u in compared.drives.items() for t in (f"{drive} [{u.force}]", "residual")],
        height=280 * n + 90,
        spacing=0.22 / (2 * n),
        row_heights=[2.2, 1.0] * n,
    )
    figure.update_layout(dragmode="zoom", hovermode="closest")
    # Seconds since 1970 need double precision.
    resolution = float(np.spacing(np.float32(np.abs(compared.time).max(initial=0.0))))
    fine = resolution < 0.05 * np.min(np.diff(compared.time), initial=np.inf)
    time = compared.time.astype(np.float32) if fine else compared.time
    for i in range(n):
        _add_drive(figure, compared, time, i)
    every = " at the rate that the filter's cut-off allows" if compared.cutoff else ""
    shown = (
        f"All samples{every} are drawn."
        if compared.stretch == 1
        else f"Of every {compared.stretch} samples the one with the largest residual is drawn."
    )
    filtered = f" after the low-pass of {compared.cutoff:.3g} Hz" if compared.cutoff else ""
    return Figure(
        style.one_legend(figure),
        f"{_efforts(compared)} of each drive{filtered}, measured (broad line) and predicted by the "
        "model (dashed), and the residual (measured minus predicted). Drag to zoom; the time axes "
        f"move together, a double click shows everything again. {shown}",
        paper=640,
    )


def _add_drive(figure: go.Figure, compared: TorqueComparison, time: np.ndarray, i: int) -> None:
    drive, units = list(compared.drives.items())[i]
    measured, predicted = compared.measured[:, i], compared.predicted[:, i]
    for name, values, line, row in (
        ("measured", measured, style.MEASURED_LINE, 2 * i + 1),
        ("predicted", predicted, style.PREDICTED_LINE, 2 * i + 1),
        ("residual", measured - predicted, {"color": style.RESIDUAL, "width": 1.0}, 2 * i + 2),
    ):
        figure.add_scatter(
            x=time,
            y=values.astype(np.float32),
            name=name,
            mode="lines",
            line=line,
            hovertemplate=f"{drive} {name} %{{y:.4g}} {units.force} at %{{x:.4g}} s<extra></extra>",
            row=row,
            col=1,
        )
    if len(compared.events):
        figure.add_scatter(
            x=np.insert(compared.events, 2, np.nan, axis=1).ravel(),
            y=np.tile([0.0, 0.0, np.nan], len(compared.events)),
            name="excluded: events",
            mode="lines",
            line={"color": style.LIMIT, "width": 5},
            hovertemplate="excluded from here at %{x:.4g} s<extra></extra>",
            row=2 * i + 2,
            col=1,
        )


def _over_speed(compared: TorqueComparison) -> Figure:
    figure, keep = grid(tuple(compared.drives), 260), even_rows(len(compared.speed), POINTS)
    for i, units in enumerate(compared.drives.values()):
        known = np.isfinite(compared.residual[:, i])
        speed, residual = units.per_shown * compared.speed[known, i], compared.residual[known, i]
        figure.add_scatter(
            x=speed[keep].astype(np.float32),
            y=residual[keep].astype(np.float32),
            name="residual",
            mode="markers",
            marker={"color": style.RESIDUAL, "size": 3, "opacity": 0.35},
            **place(i),
        )
        centre, mean, spread = _binned(speed, residual)
        figure.add_scatter(
            x=centre,
            y=mean,
            error_y={"array": spread, "thickness": 1, "width": 2},
            name="mean and standard deviation",
            mode="lines+markers",
            line={"color": style.LIMIT, "width": 1.5},
            marker={"size": 4},
            **place(i),
        )
    return Figure(
        _finished(figure, compared, "speed [{0.shown}/s]", "residual [{0.force}]"),
        "Residual over the speed of its drive, with mean and standard deviation in intervals of "
        "speed. A mean that leaves zero is a friction law that does not fit.",
    )


def _histogram(compared: TorqueComparison) -> Figure:
    figure = grid(tuple(compared.drives), 260).update_layout(bargap=0)
    for i in range(len(compared.drives)):
        residual = compared.residual[np.isfinite(compared.residual[:, i]), i]
        share, edges = np.histogram(residual, bins=60, density=True)
        middle = 0.5 * (edges[1:] + edges[:-1])
        figure.add_bar(
            x=middle,
            y=share,
            width=np.diff(edges),
            name="residual",
            marker={"color": style.RESIDUAL, "opacity": 0.7, "line": {"width": 0}},
            **place(i),
        )
        figure.add_scatter(
            x=middle,
            y=stats.norm.pdf(middle, residual.mean(), max(float(residual.std()), 1e-300)),
            name="normal distribution",
            mode="lines",
            line={"color": style.PRIOR, "width": 2},
            **place(i),
        )
    return Figure(
        _finished(figure, compared, "residual [{0.force}]", "density [1/({0.force})]"),
        "Distribution of the residuals, and the normal distribution of the same mean and spread.",
    )


def _spectrum(compared: TorqueComparison) -> Figure:
    figure, dotted = grid(tuple(compared.drives), 260), ""
    for i in range(len(compared.drives)):
        for name, density, color, dash in (
            ("measured", compared.measured_density, style.MEASURED, "solid"),
            ("residual", compared.residual_density, style.RESIDUAL, "dot"),
        ):
            figure.add_scatter(
                x=compared.frequency.astype(np.float32),
                y=density[:, i].astype(np.float32),
                name=name,
                mode="lines",
                line={"color": color, "width": 1.4, "dash": dash},
                **place(i),
            )
    if compared.cutoff:
        figure.add_vline(x=compared.cutoff, line={"color": style.PRIOR, "dash": "dot"})
        dotted = f" The dotted line is the filter's cut-off of {compared.cutoff:.3g} Hz."
    _finished(figure, compared, "frequency [Hz]", "density [{0.force}/√Hz]")
    figure.update_xaxes(type="log", dtick=1)
    figure.update_yaxes(type="log", dtick=1, exponentformat="power")
    return Figure(
        figure,
        "Amplitude spectral density (Welch's mean over segments) of the "
        f"{_efforts(compared).lower()} as recorded, and of what the model does not explain of "
        f"it.{dotted}",
    )


def _binned(speed: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, ...]:
    """Centres of speed intervals with enough samples, mean and standard deviation in each."""
    if not speed.size or np.ptp(speed) == 0:
        return speed[:0], speed[:0], speed[:0]
    edges = np.histogram_bin_edges(speed, bins=30)
    mean, spread, count = (
        stats.binned_statistic(speed, residual, what, edges)[0] for what in ("mean", "std", "count")
    )
    enough = count >= 5
    return (0.5 * (edges[1:] + edges[:-1]))[enough], mean[enough], spread[enough]


def _efforts(compared: TorqueComparison) -> str:
    return " or ".join(dict.fromkeys(u.effort for u in compared.drives.values())).capitalize()


def grid(names: Sequence[str], height: int) -> go.Figure:
    """Panels of this height [px], two per row, below the legend."""
    rows, apart = -(-len(names) // 2), {"horizontal_spacing": 0.12}
    figure = make_subplots(rows, 2, subplot_titles=names, vertical_spacing=0.3 / rows, **apart)
    figure.update_annotations(font_size=13)
    return figure.update_layout(
        height=height * rows + 100,
        margin={"t": 75},
        legend=style.LEGEND_ON_TOP,
    )


def place(i: int) -> dict[str, int]:
    """Row and column of a panel of a `grid`."""
    return {"row": i // 2 + 1, "col": i % 2 + 1}


def _finished(figure: go.Figure, compared: TorqueComparison, x: str, y: str) -> go.Figure:
    """The figure with axis titles in each drive's units, at the outer axes only if all units are
    equal, and with one legend."""
    alike = len(set(compared.drives.values())) == 1
    for i, units in enumerate(compared.drives.values()):
        if i + 2 >= len(compared.drives) or not alike:
            figure.update_xaxes(title_text=x.format(units), **place(i))
        if i % 2 == 0 or not alike:
            figure.update_yaxes(title_text=y.format(units), **place(i))
    return style.one_legend(figure)
