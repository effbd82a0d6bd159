"""Parts of several pages of a site: cells, tables of drives, figures of panels as plain data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import polars as pl

from deltaid.fleets.site.state import UNKNOWN, Row, Urgency, day
from deltaid.view import style
from deltaid.view.numbers import number, percent, with_uncertainty
from deltaid.view.page import Table

NOTHING = "—"
# Whether a robot is like its type.
LIKE = {True: "yes", False: "no", None: NOTHING}
WORDS = {Urgency.ACT: "act", Urgency.LOOK: "look", Urgency.NONE: "good"}
# Largest number of parameters in a figure, of panels, or of robots in a table.
MOST = 24
Data = dict[str, Any]
# Space for the legend and titles above the first row, for ticks below the last one, and between
# [px].
_TOP, _BOTTOM, _GAP = 70, 40, 56


@dataclass(frozen=True)
class Panel:
    """One panel.

    Attributes:
        title: above it.
        traces: Plotly's, without axes.
        shapes: the same, over the panel's own axes.
        unit: of its vertical axis.
    """

    title: str
    traces: tuple[Data, ...]
    shapes: tuple[Data, ...] = ()
    unit: str = ""


def ended(text: str) -> str:
    """A text as a sentence, with its full stop unless it is a question."""
    return text if text.endswith("?") else f"{text}."


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
    width = (1 - (columns - 1) * wide) / columns
    layout: Data = {
        "height": high + _TOP + _BOTTOM,
        "margin": {"t": _TOP, "b": _BOTTOM},
        "showlegend": legend,
        "legend": style.LEGEND_ON_TOP,
        "annotations": [],
        "shapes": [],
    }
    traces, named = list[Data](), set[str]()
    for k, panel in enumerate(panels):
        number, (line, place) = str(k + 1) if k else "", divmod(k, columns)
        left, top = place * (width + wide), 1 - line * (row + _GAP) / high
        bottom = max(top - row / high, 0.0)
        across: Data = {"domain": [left, left + width], "anchor": f"y{number}", **(x or {})}
        up: Data = {"domain": [bottom, top], "anchor": f"x{number}"}
        if panel.unit:
            up["title"] = {"text": style.label(panel.unit)}
        layout |= {f"xaxis{number}": across, f"yaxis{number}": up}
        layout["annotations"].append(
            {
                "x": left + width / 2, "y": top, "xanchor": "center", "yanchor": "bottom",
                "xref": "paper", "yref": "paper", "showarrow": False, "font": {"size": 13},
                "text": style.label(panel.title),
            }
        )  # fmt: skip
        axes = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
        layout["shapes"] += [axes | shape for shape in panel.shapes]
        for trace in panel.traces:
            name = trace.get("name", "")
            shown = {"legendgroup": name, "showlegend": legend and name not in named}
            named.add(name)
            traces.append(trace | shown | {"xaxis": f"x{number}", "yaxis": f"y{number}"})
    return {"data": traces, "layout": layout}


def numbers(values: pl.Series) -> list[float | None]:
    """Values with five significant digits, the resolution of a screen."""
    return values.round_sig_figs(5).to_list()


def dates(values: pl.Series) -> list[str]:
    """Days in Plotly's format, with hours if a day has several."""
    several = values.dt.date().is_duplicated().any()
    return values.dt.strftime("%Y-%m-%d %H:%M" if several else "%Y-%m-%d").to_list()


def cell(form: Callable[..., str], *values: Any) -> str:
    """Values as text, or a dash if one is unknown."""
    return NOTHING if None in values else form(*values)


def known(value: float, std: float | None) -> tuple[str, str]:
    """A number and its ±, if known."""
    return with_uncertainty(value, std) if std is not None else (number(value), "")


def days(low: datetime | None, high: datetime | None) -> str:
    """An interval of dates; 'later' if it has no end."""
    if low is None and high is None:
        return NOTHING
    return f"{day(low)} … {day(high) if high is not None else 'later'}"


def bounds(drives: Sequence[Row]) -> list[str]:
    """Bounds of false alarms, in words, each once."""
    return list(dict.fromkeys(drive["bound"] for drive in drives))


def drive_tables(drives: Sequence[Row], caption: str) -> tuple[Table, Table]:
    rows = tuple(
        (
            drive["drive"],
            UNKNOWN if drive["state"] == "unknown" else drive["state"],
            day(drive["change"]),
            days(drive["change_low"], drive["change_high"]),
            cell(percent, drive["rate"]),
            cell(
                lambda low, high: f"{percent(low)} … {percent(high)}",
                *(drive["rate_low"], drive["rate_high"]),
            ),
            cell(percent, drive["temperature_slope"]),
            cell(str, drive["recordings"]),
        )
        for drive in drives
    )
    columns = ("drive", "friction", "changed on", "between", "a month", "between", "per K",
               "recordings")  # fmt: skip
    limits = tuple(
        (
            drive["drive"],
            cell(lambda level, unit: f"{number(level)} {unit}", drive["level"], drive["unit"]),
            cell(number, drive["limit"]),
            day(drive["horizon"]),
            days(drive["horizon_low"], drive["horizon_high"]),
            drive["reason"],
        )
        for drive in drives
    )
    marked = frozenset(
        k for k, drive in enumerate(drives) if drive["state"] not in ("steady", "unknown")
    )
    return (
        Table(columns, rows, caption, marked=marked),
        Table(("drive", "level", "limit", "reached on", "between", "remarks"), limits),
    )
