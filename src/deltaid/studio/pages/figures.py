"""Figures of the studio: curves over one time axis, legible on light and dark ground."""

from collections.abc import Sequence

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from deltaid.studio.look import Preview
from deltaid.studio.torques import Beside

_COLOURS = ("#1f77b4", "#d9730d", "#2c9a55", "#a64ca6")
_MEASURED = "#8a949e"
_GRID = "rgba(128,128,128,.25)"
_HEIGHT = 190


def curves(seen: Preview) -> go.Figure:
    """Curves of all drives, one row a quantity, over one time axis."""
    quantities = list(dict.fromkeys(one.quantity for one in seen.curves))
    plot = make_subplots(rows=len(quantities), cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for one in seen.curves:
        row = quantities.index(one.quantity) + 1
        plot.add_trace(
            go.Scatter(
                x=one.time,
                y=one.values,
                name=f"drive {one.drive + 1}",
                legendgroup=str(one.drive),
                showlegend=row == 1,
                line={"color": _COLOURS[one.drive % len(_COLOURS)], "width": 1},
            ),
            row=row,
            col=1,
        )
        plot.update_yaxes(title_text=f"{one.quantity} [{one.unit}]", row=row, col=1)
    return _dressed(plot, len(quantities))


def beside(found: Beside, names: Sequence[str]) -> go.Figure:
    """Measured and predicted torques, a row a drive; the time axes move together."""
    plot = make_subplots(rows=len(found.drives), cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for i, (drive, unit) in enumerate(zip(found.drives, found.units, strict=True)):
        lines = [("measured", _MEASURED, 2.5, found.time[0], found.measured[0])]
        predicted = zip(names, _COLOURS, found.time, found.predicted, strict=False)
        lines += [(name, color, 1.2, time, values) for name, color, time, values in predicted]
        for name, color, width, time, values in lines:
            line = {"color": color, "width": width}
            trace = go.Scatter(
                x=time, y=values[:, i], name=name, legendgroup=name, showlegend=i == 0, line=line
            )
            plot.add_trace(trace, row=i + 1, col=1)
        plot.update_yaxes(title_text=f"{drive} [{unit}]", row=i + 1, col=1)
    return _dressed(plot, len(found.drives))


def _dressed(plot: go.Figure, rows: int) -> go.Figure:
    plot.update_xaxes(title_text="time [s]", row=rows, col=1)
    plot.update_xaxes(gridcolor=_GRID, zeroline=False)
    plot.update_yaxes(gridcolor=_GRID, zeroline=False)
    plot.update_layout(
        height=_HEIGHT * rows + 60,
        margin={"l": 60, "r": 10, "t": 10, "b": 40},
        legend={"orientation": "h", "y": 1.08},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": "#7a8691"},
    )
    return plot
