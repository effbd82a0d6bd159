"""Pieces that several pages of a site have: small cells, figures of panels as plain data, tables of
drives, deviations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import polars as pl

from deltaid.fleets.site.state import UNKNOWN, Robot, Row, Urgency, day
from deltaid.view import style
from deltaid.view.numbers import number, percent, span, with_uncertainty
from deltaid.view.page import Table

NOTHING = "—"
# Whether a robot is like its type.
LIKE = {True: "yes", False: "no", None: NOTHING}
WORDS = {Urgency.ACT: "act", Urgency.LOOK: "look", Urgency.NONE: "good"}
# Parameters that a figure shows at most.
MOST = 24
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
        above = {"x": left + width / 2, "y": top, "xanchor": "center", "yanchor": "bottom"}
        above |= {"xref": "paper", "yref": "paper", "showarrow": False, "font": {"size": 13}}
        layout["annotations"].append(above | {"text": style.label(panel.title)})
        axes = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
        layout["shapes"] += [axes | shape for shape in panel.shapes]
        for trace in panel.traces:
            name = trace.get("name", "")
            shown = {"legendgroup": name, "showlegend": legend and name not in named}
            named.add(name)
            traces.append(trace | shown | {"xaxis": f"x{number}", "yaxis": f"y{number}"})
    return {"data": traces, "layout": layout}


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


def shown(value: float | None, digits: int = 4) -> str:
    """A number, or a dash."""
    return NOTHING if value is None else number(value, digits)


def count(value: int | None) -> str:
    """A count, or a dash."""
    return NOTHING if value is None else str(value)


def share(value: float | None) -> str:
    """A share in per cent, or a dash."""
    return NOTHING if value is None else percent(value)


def state(robot: Robot) -> str:
    """How soon somebody should look at a robot, or that nobody can tell."""
    is_open = robot.urgency is Urgency.NONE and not robot.is_known
    return UNKNOWN if is_open else WORDS[robot.urgency]


def known(value: float | None, std: float | None) -> tuple[str, str]:
    """A number and its ±, or a dash."""
    if value is None:
        return NOTHING, ""
    return with_uncertainty(value, std) if std is not None else (number(value), "")


def between(low: float | None, high: float | None) -> str:
    """An interval, or a dash."""
    return NOTHING if low is None or high is None else span(low, high)


def days(low: datetime | None, high: datetime | None) -> str:
    """An interval of dates; 'later' where it has no end."""
    if low is None and high is None:
        return NOTHING
    return f"{day(low)} … {day(high) if high is not None else 'later'}"


def bounds(drives: Sequence[Row]) -> list[str]:
    """Bounds of false alarms of drift, in words, each once."""
    return list(dict.fromkeys(drive["bound"] for drive in drives))


def drive_tables(drives: Sequence[Row], caption: str = "") -> tuple[Table, Table]:
    """What is known of each drive's friction over time, and why."""
    rows = tuple(
        (
            drive["drive"],
            UNKNOWN if drive["state"] == "unknown" else drive["state"],
            day(drive["change"]),
            days(drive["change_low"], drive["change_high"]),
            share(drive["rate"]),
            _shares(drive["rate_low"], drive["rate_high"]),
            share(drive["temperature_slope"]),
            count(drive["recordings"]),
        )
        for drive in drives
    )
    columns = ("drive", "friction", "changed on", "between", "a month", "between", "per K",
               "recordings")  # fmt: skip
    marked = frozenset(
        k for k, drive in enumerate(drives) if drive["state"] not in ("steady", "unknown")
    )
    limits = tuple(
        (
            drive["drive"],
            f"{shown(drive['level'])} {drive['unit']}" if drive["level"] is not None else NOTHING,
            shown(drive["limit"]),
            day(drive["horizon"]),
            days(drive["horizon_low"], drive["horizon_high"]),
            drive["reason"],
        )
        for drive in drives
    )
    return (
        Table(columns, rows, caption, marked=marked),
        Table(("drive", "level", "limit", "reached on", "between", "remarks"), limits),
    )


def _shares(low: float | None, high: float | None) -> str:
    return NOTHING if low is None or high is None else f"{percent(low)} … {percent(high)}"


def deviation_figure(members: pl.DataFrame, parameters: Sequence[str]) -> Data:
    """Deviations from the type's mean, a box a parameter; robots that do not belong stand out."""
    own = members.filter(
        pl.col("parameter").is_in(list(parameters)) & pl.col("spreads").is_not_null()
    ).rename({"spreads": "x"})
    alike, foreign = (own.filter(pl.col("belongs").fill_null(True) == is_) for is_ in (True, False))
    common = {"orientation": "h", "hovertemplate": "%{text}: %{x:.3g}<extra>%{y}</extra>"}
    traces = [dots(alike, "x", "robot") | common | {"y": alike["parameter"].to_list()}]
    if len(foreign):
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": numbers(foreign["x"]),
                "y": foreign["parameter"].to_list(),
                "text": [style.label(name) for name in foreign["robot"].to_list()],
                "marker": {"color": style.LIMIT, "size": 8, "symbol": "diamond"},
                "hovertemplate": "%{text}: %{x:.3g}<extra>%{y}</extra>",
            }
        )
    names = ("robots", "robots that do not belong")
    return {
        "data": [trace | {"name": name} for trace, name in zip(traces, names, strict=False)],
        "layout": {
            "height": 26 * len(parameters) + 120,
            "xaxis": {"title": {"text": "deviation from the type's mean [spreads]"}},
            "yaxis": {"categoryorder": "array", "categoryarray": list(parameters)[::-1]},
        },
    }


def most_spread(members: pl.DataFrame) -> list[str]:
    """Parameters of which robots differ most, in the order of the table."""
    sizes = (
        members.drop_nulls("spreads")
        .group_by("parameter", maintain_order=True)
        .agg(pl.col("spreads").abs().max())
    )
    chosen = sizes.sort("spreads", "parameter", descending=[True, False]).head(MOST)["parameter"]
    return sizes.filter(pl.col("parameter").is_in(chosen.to_list()))["parameter"].to_list()
