"""Pieces that several pages of a site have: small cells, tables of drives, deviations."""

from collections.abc import Sequence
from datetime import datetime

import polars as pl

from deltaid.fleets.site.panels import Data, dots, numbers
from deltaid.fleets.site.state import Row, Urgency, day
from deltaid.view import style
from deltaid.view.numbers import number, percent, span, with_uncertainty
from deltaid.view.page import Table

NOTHING = "—"
WORDS = {Urgency.ACT: "act", Urgency.LOOK: "look", Urgency.NONE: "good"}
# Parameters that a figure shows at most.
MOST = 24


def shown(value: float | None, digits: int = 4) -> str:
    """A number, or a dash."""
    return NOTHING if value is None else number(value, digits)


def count(value: int | None) -> str:
    """A count, or a dash."""
    return NOTHING if value is None else str(value)


def share(value: float | None) -> str:
    """A share in per cent, or a dash."""
    return NOTHING if value is None else percent(value)


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
    words = (
        drive["bound"] or f"at most {number(drive['false_alarms'])} a robot-year"
        for drive in drives
        if drive["bound"] or drive["false_alarms"] is not None
    )
    return list(dict.fromkeys(words))


def drive_tables(drives: Sequence[Row], caption: str = "") -> tuple[Table, Table]:
    """What is known of each drive's friction over time, and why."""
    rows = tuple(
        (
            drive["drive"],
            drive["state"],
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
    states = [drive["state"] for drive in drives]
    marked = frozenset(k for k, state in enumerate(states) if state not in ("steady", "unknown"))
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
    members = members.filter(pl.col("spreads").is_not_null())
    if members.is_empty():
        return []
    order = list(dict.fromkeys(members["parameter"].to_list()))
    largest = (
        members.group_by("parameter")
        .agg(pl.col("spreads").abs().max().alias("largest"))
        .sort("largest", "parameter", descending=[True, False])
        .head(MOST)["parameter"]
    )
    chosen = set(largest.to_list())
    return [name for name in order if name in chosen]
