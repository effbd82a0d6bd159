"""Pieces that several pages of a site have: small cells, tables of drives, deviations."""

from collections.abc import Sequence
from datetime import datetime

import plotly.graph_objects as go
import polars as pl

from deltaid.fleet_site.state import Row, Urgency, day
from deltaid.report import style
from deltaid.report.numbers import number, percent, span
from deltaid.report.table import Table

NOTHING = "—"
WORDS = {Urgency.ACT: "act", Urgency.LOOK: "look", Urgency.NONE: "good"}
# Parameters that a figure shows at most.
MOST = 24


def shown(value: float | None, digits: int = 4) -> str:
    """A number, or a dash."""
    return NOTHING if value is None else number(value, digits)


def share(value: float | None) -> str:
    """A share in per cent, or a dash."""
    return NOTHING if value is None else percent(value)


def between(low: float | None, high: float | None) -> str:
    """An interval, or a dash."""
    return NOTHING if low is None or high is None else span(low, high)


def days(low: datetime | None, high: datetime | None) -> str:
    """An interval of dates; 'later' where it has no end."""
    if low is None and high is None:
        return NOTHING
    return f"{day(low)} … {day(high) if high is not None else 'later'}"


def drive_table(drives: Sequence[Row], caption: str = "") -> Table:
    """What is known of each drive's friction over time."""
    rows = tuple(
        (
            one["drive"],
            one["state"],
            day(one["change"]),
            days(one["change_low"], one["change_high"]),
            share(one["rate"]),
            _shares(one["rate_low"], one["rate_high"]),
            shown(one["level"]),
            shown(one["limit"]),
            day(one["horizon"]),
            days(one["horizon_low"], one["horizon_high"]),
            share(one["temperature_slope"]),
            shown(one["recordings"]),
            one["reason"],
        )
        for one in drives
    )
    columns = ("drive", "friction", "changed on", "within", "a month", "within", "level", "limit",
               "limit reached on", "within", "per K", "recordings", "why")  # fmt: skip
    marked = frozenset(
        k for k, one in enumerate(drives) if one["state"] not in ("steady", "unknown")
    )
    return Table(columns, rows, caption, marked=marked)


def _shares(low: float | None, high: float | None) -> str:
    return NOTHING if low is None or high is None else f"{percent(low)} … {percent(high)}"


def deviation_figure(members: pl.DataFrame, parameters: Sequence[str], title: str) -> go.Figure:
    """Deviations from the type's mean, one box a parameter, robots that do not belong as dots."""
    figure = go.Figure()
    own = members.filter(pl.col("parameter").is_in(list(parameters)))
    for belongs, name, color in (
        (True, "robots", style.MEASURED), (False, "do not belong", style.LIMIT),
    ):  # fmt: skip
        rows = own.filter(pl.col("belongs").fill_null(True) == belongs)
        if rows.is_empty():
            continue
        figure.add_trace(
            go.Box(
                x=rows["deviation"].to_numpy(),
                y=rows["parameter"].to_list(),
                text=[style.label(name) for name in rows["robot"].to_list()],
                orientation="h",
                boxpoints="all" if not belongs or len(rows) <= 2000 else "outliers",
                jitter=0.4,
                pointpos=0,
                marker={"color": color, "size": 4 if belongs else 7, "opacity": 0.7},
                line={"width": 1 if belongs else 0},
                fillcolor="rgba(0,0,0,0)",
                hovertemplate="%{text}: %{x:.3g}<extra>%{y}</extra>",
                hoveron="points",
                name=name,
            )
        )
    figure.update_layout(
        height=26 * len(parameters) + 120,
        xaxis={"title": {"text": title}},
        yaxis={"categoryorder": "array", "categoryarray": list(parameters)[::-1]},
    )
    return figure


def most_spread(members: pl.DataFrame) -> list[str]:
    """Parameters of which robots differ most, in the order of the table."""
    if members.is_empty():
        return []
    order = list(dict.fromkeys(members["parameter"].to_list()))
    largest = (
        members.group_by("parameter")
        .agg(pl.col("deviation").abs().max().fill_null(0.0).alias("largest"))
        .sort("largest", "parameter", descending=[True, False])
        .head(MOST)["parameter"]
    )
    chosen = set(largest.to_list())
    return [name for name in order if name in chosen]
