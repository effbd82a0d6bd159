"""Friction of drives over time: what was seen, when it changed, how fast, and until when."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import plotly.graph_objects as go
import polars as pl
from plotly.subplots import make_subplots

from deltaid.fleet_site.state import Row
from deltaid.report import style
from deltaid.report.numbers import WIDTH, number

_MONTH = timedelta(days=30.4375)
_ROW = 210


@dataclass(frozen=True)
class Panel:
    """One drive.

    Attributes:
        title: of the panel.
        seen: its rows of the table of friction, of one quantity.
        drift: its row of the table of drift.
    """

    title: str
    seen: pl.DataFrame
    drift: Row | None = None


def main_quantity(seen: pl.DataFrame) -> pl.DataFrame:
    """Rows of the quantity that comes first, which drift is told of."""
    if seen.is_empty():
        return seen
    return seen.filter(pl.col("quantity") == seen["quantity"][0]).sort("time")


def friction_figure(panels: Sequence[Panel], columns: int = 1) -> go.Figure:
    """One panel a drive, with one axis of time."""
    rows = -(-len(panels) // columns)
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[style.label(one.title) for one in panels],
        shared_xaxes=True,
        vertical_spacing=0.28 / max(rows, 2),
        horizontal_spacing=0.2 / max(columns, 2),
    )
    traces, places, shapes = list[Any](), list[tuple[int, int]](), list[dict[str, Any]]()
    named = set[str]()
    for k, panel in enumerate(panels):
        place = k // columns + 1, k % columns + 1
        for trace in _traces(panel):
            trace.update(legendgroup=trace.name, showlegend=trace.name not in named)
            named.add(trace.name)
            traces.append(trace)
            places.append(place)
        shapes += _change(panel, k)
        unit = panel.seen["unit"][0] if len(panel.seen) else ""
        if place[1] == 1:
            figure.update_yaxes(title_text=style.label(f"[{unit}]"), row=place[0], col=1)
    figure.add_traces(traces, rows=[row for row, _ in places], cols=[col for _, col in places])
    figure.update_annotations(font_size=13)
    figure.update_layout(
        shapes=shapes,
        height=_ROW * rows + 90,
        margin={"t": 70},
        legend={"y": 1.0, "yanchor": "top", "yref": "container"},
    )
    return figure


def _traces(panel: Panel) -> list[go.Scatter]:
    """What was seen, and where it leads."""
    seen = panel.seen
    traces = [
        go.Scatter(
            x=seen["time"].to_list(),
            y=seen["value"].to_numpy(),
            error_y={"array": (WIDTH * seen["std"].fill_null(0)).to_numpy(), "width": 0,
                     "thickness": 1},
            customdata=_shown(seen["temperature"]),
            hovertemplate="%{x|%Y-%m-%d}: %{y:.4g}%{customdata}<extra></extra>",
            name="friction, with 95 % intervals",
            mode="markers",
            marker={"color": style.MEASURED, "size": 5},
        )
    ]  # fmt: skip
    if panel.drift is not None and panel.drift["state"] in ("rising", "falling"):
        traces += _trend(panel.drift, seen)
    return traces


def _shown(temperature: pl.Series) -> list[str]:
    return ["" if t is None else f" at {number(t, 3)} °C" for t in temperature.to_list()]


def _trend(row: Row, seen: pl.DataFrame) -> list[go.Scatter]:
    """The line of the rate with its interval, from the change to the limit, and the limit."""
    begin = row["change"] or (seen["time"][0] if len(seen) else None)
    if begin is None or row["rate"] is None or row["level"] is None or not len(seen):
        return []
    last = seen["time"][-1]
    end = _end(row, begin, last)
    months = (end - begin) / _MONTH
    traces = []
    if row["rate_low"] is not None and row["rate_high"] is not None:
        low, high = (row["level"] * (1 + row[key] * months) for key in ("rate_low", "rate_high"))
        traces.append(
            go.Scatter(
                x=[begin, end, end],
                y=[row["level"], high, low],
                name="its 95 % interval",
                mode="lines",
                line={"width": 0},
                fill="toself",
                fillcolor=style.PREDICTED,
                opacity=0.25,
                hoverinfo="skip",
            )
        )
    reached = row["level"] * (1 + row["rate"] * months)
    traces.append(_line("rate", [begin, end], [row["level"], reached], style.PREDICTED, "solid"))
    if row["limit"] is not None:
        first = seen["time"][0]
        traces.append(_line("limit", [first, end], [row["limit"]] * 2, style.LIMIT, "dash"))
    return traces


def _end(row: Row, begin: datetime, last: datetime) -> datetime:
    """As far as a line is drawn: to the limit, but not much beyond what was seen."""
    furthest = last + max(last - begin, _MONTH)
    return min(max(row["horizon"] or last, last), furthest)


def _line(name: str, x: list[datetime], y: list[float], color: str, dash: str) -> go.Scatter:
    return go.Scatter(
        x=x, y=y, name=name, mode="lines", line={"color": color, "width": 2, "dash": dash}
    )  # fmt: skip


def _change(panel: Panel, k: int) -> list[dict[str, Any]]:
    """The day of a change, and the days that it may have been."""
    row = panel.drift
    if row is None or row["change"] is None:
        return []
    axis = str(k + 1) if k else ""
    place = {"xref": f"x{axis}", "yref": f"y{axis} domain", "y0": 0, "y1": 1}
    shapes = [
        {**place, "type": "line", "x0": row["change"], "x1": row["change"],
         "line": {"color": style.RESIDUAL, "width": 1.5, "dash": "dot"}}
    ]  # fmt: skip
    if row["change_low"] is not None and row["change_high"] is not None:
        shapes.append(
            {**place, "type": "rect", "x0": row["change_low"], "x1": row["change_high"],
             "fillcolor": style.RESIDUAL, "opacity": 0.18, "line": {"width": 0}}
        )  # fmt: skip
    return shapes
