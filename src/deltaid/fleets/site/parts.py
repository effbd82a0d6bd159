"""Parts of several pages of a site: cells, tables of drives, and figures of panels as plain data,
such as drives' friction over time: recordings, changes, trends, limits."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import polars as pl

from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.drift_evidence import MONTH
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
# The quantity with findings of drift.
MAIN = "friction"
_NAME = "friction, with 95 % intervals"
_MONTH = timedelta(days=MONTH)
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


def drive_tables(drives: Sequence[Row], caption: str = "") -> tuple[Table, Table]:
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


def friction_panel(title: str, series: pl.DataFrame, drift: Row | None) -> Panel:
    """One drive over time.

    Args:
        series: its rows of the table of friction, of one quantity, sorted by time.
        drift: its row of the table of drift, if the quantity has findings.
    """
    unit = f"[{series['unit'][0]}]"
    slope = None if drift is None else drift["temperature_slope"]
    traces, value, name = list[Data](), "value", _NAME
    if slope is not None and series["temperature"].null_count() < len(series):
        warm = pl.col("temperature") - pl.col("temperature").mean()
        cooled = (pl.col("value") * (-slope * warm).exp()).fill_null(pl.col("value"))
        series = series.with_columns(cooled=cooled)
        degrees = series["temperature"].to_list()
        faint = {  # recorded values, at any temperature
            "marker": {"color": style.PRIOR, "size": 4, "opacity": 0.5},
            "text": ["" if t is None else f" at {number(t, 3)} °C" for t in degrees],
            "hovertemplate": "%{x|%Y-%m-%d}: %{y:.4g}%{text}<extra></extra>",
        }
        traces, value = [_dots(series, "value", "as recorded") | faint], "cooled"
        name = f"{_NAME}, at one temperature"
    error = {
        "type": "data",
        "array": numbers(NORMAL * series["std"].fill_null(0.0)),
        "width": 0,
        "thickness": 1,
    }
    traces.append(_dots(series, value, name) | {"error_y": error})
    if drift is None:
        return Panel(title, tuple(traces), unit=unit)
    if drift["state"] in ("rising", "falling"):
        traces += _trend(drift, series)
    elif drift["state"] == "stepped":
        traces += _step(drift, series)
    return Panel(title, tuple(traces), _change(drift), unit)


def time_axis(series: pl.DataFrame) -> Data:
    """Time axis of all panels; a single time gets some days around it."""
    axis: Data = {"type": "date", "matches": "x"}
    first, last = series["time"].min(), series["time"].max()
    if isinstance(first, datetime) and first == last:
        axis["range"] = [_minute(first + timedelta(days=days)) for days in (-3, 3)]
    return axis


def _dots(series: pl.DataFrame, value: str, name: str) -> Data:
    return {
        "type": "scatter",
        "x": dates(series["time"]),
        "y": numbers(series[value]),
        "hovertemplate": "%{x|%Y-%m-%d}: %{y:.4g}<extra></extra>",
        "name": name,
        "mode": "markers",
        "marker": {"color": style.MEASURED, "size": 5},
    }


def _trend(row: Row, series: pl.DataFrame) -> list[Data]:
    """The line of the rate with its interval, from the change on, and the limit.

    A rate is a share per month, so friction grows exponentially; over the drawn range a straight
    line is as good.
    """
    first, last, begin, level = series["time"][0], series["time"][-1], row["change"], row["level"]
    # To the limit, but not far beyond the recordings.
    end = min(max(row["horizon"] or last, last), last + max(last - begin, _MONTH))
    low, middle, high = (
        level * (1 + row[key]) ** ((end - begin) / _MONTH)
        for key in ("rate_low", "rate", "rate_high")
    )
    band = {
        "type": "scatter",
        "x": [_minute(begin), _minute(end), _minute(end)],
        "y": [level, high, low],
        "name": "its 95 % interval",
        "mode": "lines",
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": style.PREDICTED,
        "opacity": 0.25,
        "hoverinfo": "skip",
    }
    return [
        band,
        _line("rate", [begin, end], [level, middle], style.PREDICTED, "solid"),
        *_limit(row, first, end),
    ]


def _step(row: Row, series: pl.DataFrame) -> list[Data]:
    first, last = series["time"][0], series["time"][-1]
    on, before = row["change"], row["level"]
    after = before * (1 + row["step"])
    y = [before, before, after, after]
    return [
        _line("level", [first, on, on, last], y, style.PREDICTED, "solid"),
        *_limit(row, first, last),
    ]


def _limit(row: Row, first: datetime, last: datetime) -> list[Data]:
    if row["limit"] is None:
        return []
    return [_line("limit", [first, last], [row["limit"]] * 2, style.LIMIT, "dash")]


def _line(name: str, times: list[datetime], y: list[Any], color: str, dash: str) -> Data:
    return {
        "type": "scatter", "x": [_minute(time) for time in times], "y": y, "name": name,
        "mode": "lines", "line": {"color": color, "width": 2, "dash": dash},
    }  # fmt: skip


def _change(row: Row) -> tuple[Data, ...]:
    if row["change"] is None:
        return ()
    on, low, high = (row[key] for key in ("change", "change_low", "change_high"))
    line = {"type": "line", "x0": _minute(on), "x1": _minute(on),
            "line": {"color": style.RESIDUAL, "width": 1.5, "dash": "dot"}}  # fmt: skip
    band = {"type": "rect", "x0": _minute(low), "x1": _minute(high), "fillcolor": style.RESIDUAL,
            "opacity": 0.18, "line": {"width": 0}}  # fmt: skip
    return line, band


def _minute(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M}"
