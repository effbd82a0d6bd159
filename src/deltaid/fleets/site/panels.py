"""Figures of several panels as plain data, and columns of tables as Plotly takes them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from deltaid.view import style

Data = dict[str, Any]
# Room for the legend and titles above the first row, and for ticks below the last one [px].
_TOP, _BOTTOM, _GAP = 70, 40, 56


@dataclass(frozen=True)
class Panel:
    """One panel.

    Attributes:
        title: above it.
        traces: Plotly's, without axes.
        shapes: the same, over the panel's own axes.
        unit: beside its vertical axis.
    """

    title: str
    traces: tuple[Data, ...]
    shapes: tuple[Data, ...] = ()
    unit: str = ""


def grid(
    panels: Sequence[Panel],
    columns: int = 1,
    *,
    row: int = 150,
    x: Mapping[str, Any] | None = None,
    legend: bool = False,
) -> Data:
    """A figure of panels, row by row.

    Args:
        row: height of a panel [px].
        x: of all horizontal axes.
        legend: whether names of traces are shown, each once.
    """
    rows = -(-len(panels) // columns)
    high = rows * row + (rows - 1) * _GAP
    wide = 0.07 if columns > 1 else 0.0
    layout: Data = {
        "height": high + _TOP + _BOTTOM,
        "margin": {"t": _TOP, "b": _BOTTOM},
        "showlegend": legend,
        "legend": {"y": 1.0, "yanchor": "top", "yref": "container"},
        "annotations": [],
        "shapes": [],
    }
    traces, named = list[Data](), set[str]()
    for k, panel in enumerate(panels):
        number = str(k + 1) if k else ""
        line, place = divmod(k, columns)
        width = (1 - (columns - 1) * wide) / columns
        left = place * (width + wide)
        top = 1 - line * (row + _GAP) / high
        bottom = max(top - row / high, 0.0)
        layout[f"xaxis{number}"] = {"domain": [left, left + width], "anchor": f"y{number}"}
        layout[f"xaxis{number}"] |= x or {}
        layout[f"yaxis{number}"] = {"domain": [bottom, top], "anchor": f"x{number}"}
        if panel.unit:
            layout[f"yaxis{number}"]["title"] = {"text": style.label(panel.unit)}
        layout["annotations"].append(_title(panel.title, left + width / 2, top))
        axes = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
        layout["shapes"] += [axes | shape for shape in panel.shapes]
        for trace in panel.traces:
            name = trace.get("name", "")
            shown = {"legendgroup": name, "showlegend": legend and name not in named}
            named.add(name)
            traces.append(trace | shown | {"xaxis": f"x{number}", "yaxis": f"y{number}"})
    return {"data": traces, "layout": layout}


def _title(text: str, x: float, y: float) -> Data:
    place = {"x": x, "y": y, "xref": "paper", "yref": "paper", "xanchor": "center"}
    return place | {"yanchor": "bottom", "showarrow": False, "font": {"size": 13},
                    "text": style.label(text)}  # fmt: skip


def numbers(values: pl.Series) -> list[float | None]:
    """Five significant digits, which no screen shows more of."""
    return values.round_sig_figs(5).to_list()


def dates(values: pl.Series) -> list[str]:
    """Days as Plotly takes them, with hours where a day has several."""
    several = values.dt.date().is_duplicated().any()
    return values.dt.strftime("%Y-%m-%d %H:%M" if several else "%Y-%m-%d").to_list()


def dots(rows: pl.DataFrame, value: str, text: str) -> Data:
    """A box with a dot for each row, which says a text."""
    return {
        "type": "box",
        "text": [style.label(name) for name in rows[text].to_list()],
        "boxpoints": "all",
        "jitter": 0.5,
        "pointpos": 0,
        "marker": {"color": style.MEASURED, "size": 4, "opacity": 0.6},
        "line": {"width": 1},
        "fillcolor": "rgba(0,0,0,0)",
        "hoveron": "points",
    } | {value: numbers(rows[value])}
