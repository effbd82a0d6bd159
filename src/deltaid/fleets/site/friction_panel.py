"""Friction of a drive over time as a panel: recordings, changes, trends, limits."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Any

import polars as pl

from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.drift_evidence import MONTH
from deltaid.fleets.site.parts import Data, Panel, dates, numbers
from deltaid.fleets.site.state import Row
from deltaid.view import style
from deltaid.view.numbers import number

# The quantity with findings of drift.
MAIN = "friction"
_NAME = "friction, with 95 % intervals"
_MONTH = timedelta(days=MONTH)


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


def _limit(row: Row, first: datetime, last: datetime) -> Iterator[Data]:
    if row["limit"] is not None:
        yield _line("limit", [first, last], [row["limit"]] * 2, style.LIMIT, "dash")


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
