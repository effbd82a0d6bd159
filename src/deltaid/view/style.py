"""Style of figures: colours with one meaning each, light and dark templates, escaped labels."""

import html
from collections.abc import Sequence
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

# One colour for each meaning in all figures: those of Okabe and Ito, which colour-blind people can
# distinguish, slightly lighter for white and black backgrounds.
MEASURED = "#2b83c6"
PREDICTED = "#e0701f"
RESIDUAL = "#17a07a"
PRIOR = "#8b929b"
IDENTIFIED = PREDICTED
LIMIT = "#c2508f"
# Measured and predicted differ not only in colour: a broad line, and a thin dashed one on top.
MEASURED_LINE = {"color": "#7fb5e0", "width": 4.0}
PREDICTED_LINE = {"color": "#b3470a", "width": 1.5, "dash": "6px,2px"}
# Cycle of colours without a meaning, to distinguish drives or bodies.
SERIES = ("#2b83c6", "#e0701f", "#17a07a", "#c2508f", "#b59400", "#5aa9d6", "#8b929b")
# Position of a legend above the titles of panels.
LEGEND_ON_TOP = {"y": 1.0, "yanchor": "top", "yref": "container"}
# Axis of names, listed from the top.
DOWNWARDS = {"autorange": "reversed", "tickmode": "linear", "dtick": 1}

_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', sans-serif"
_CLEAR = "rgba(0,0,0,0)"
# Colours with a contrast of 4.5 on white and on the dark pages of notebooks.
_TEXT, _LINE, _GRID = "#768390", "rgba(128,128,128,.5)", "rgba(128,128,128,.2)"


def template(dark: bool) -> go.layout.Template:
    """Template of a page's figures, for a light or a dark background."""
    text, line, grid = (
        ("#d7dce2", "#525b66", "#2c333b") if dark else ("#24292f", "#9aa3ad", "#e4e8ec")
    )
    axis = {
        "gridcolor": grid,
        "linecolor": line,
        "zerolinecolor": line,
        "zerolinewidth": 1,
        "automargin": True,
        "title": {"standoff": 8, "font": {"size": 12}},
        "tickfont": {"size": 11},
    }
    wall = {**axis, "backgroundcolor": _CLEAR, "showbackground": False}
    wall.pop("automargin")
    wall["title"] = {"font": {"size": 12}}
    return go.layout.Template(
        layout={
            "paper_bgcolor": _CLEAR,
            "plot_bgcolor": _CLEAR,
            "font": {"family": _FONT, "size": 13, "color": text},
            "colorway": SERIES,
            "xaxis": axis,
            "yaxis": axis,
            "scene": {"xaxis": wall, "yaxis": wall, "zaxis": wall, "bgcolor": _CLEAR},
            "legend": {
                "orientation": "h",
                "x": 0,
                "xanchor": "left",
                "y": 1,
                "yanchor": "bottom",
                "itemsizing": "constant",
            },
            "margin": {"l": 56, "r": 12, "t": 40, "b": 44},
            "hoverlabel": {"font": {"family": _FONT, "size": 12}},
            "modebar": {"bgcolor": _CLEAR, "color": line, "activecolor": text},
        }
    )


def label(text: str) -> str:
    """Text for a title, a legend or a hover box, with Plotly's tags escaped."""
    return html.escape(text, quote=False)


def themed(figure: go.Figure) -> go.Figure:
    """A copy for light and dark notebooks, no wider than its cell."""
    both = template(False)
    axis = {"gridcolor": _GRID, "linecolor": _LINE, "zerolinecolor": _LINE}
    both.layout.update(
        font={"color": _TEXT},
        xaxis=axis,
        yaxis=axis,
        scene=dict.fromkeys(("xaxis", "yaxis", "zaxis"), axis),
    )
    return go.Figure(figure).update_layout(template=both, autosize=True)


def stacked(
    titles: Sequence[str], height: float, spacing: float, time: str = "time [s]", **options: Any
) -> go.Figure:
    """Panels one below the other, each with the title of its y axis, over one time axis.

    Args:
        height: of all of them [px].
        spacing: between two of them, as a share of the height.
    """
    rows = len(titles)
    figure = make_subplots(
        rows=rows, cols=1, shared_xaxes=True, vertical_spacing=spacing, **options
    )
    for row, title in enumerate(titles, 1):
        next(figure.select_yaxes(row=row, col=1)).update(title_text=title)
    figure.update_xaxes(title_text=time, row=rows, col=1)
    return figure.update_layout(height=height)


def bars(
    names: Sequence[str], lengths: Sequence[float], title: str, height: int, **look: Any
) -> go.Figure:
    """A horizontal bar for each name, from the top; `title` is that of the axis of lengths."""
    bar = go.Bar(x=lengths, y=[label(name) for name in names], orientation="h", **look)
    axes = {"yaxis": DOWNWARDS, "xaxis": {"title": title, "rangemode": "tozero"}}
    return go.Figure(bar, axes | {"height": height, "margin": {"t": 20}, "bargap": 0.35})


def one_legend(figure: go.Figure) -> go.Figure:
    """The figure with one legend entry for all traces of a name in its panels."""
    names = set[str]()
    for trace in figure.data:
        trace.update(legendgroup=trace.name, showlegend=trace.name not in names)
        names.add(trace.name)
    return figure
