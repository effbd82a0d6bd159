"""Recordings in memory, as they are."""

import re
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from deltaid.recording.mapping import TIMES
from deltaid.recording.memory import FrameTable, Recording
from deltaid.view.card import Card
from deltaid.view.numbers import number
from deltaid.view.table import Table

if TYPE_CHECKING:
    import plotly.graph_objects as go

# Groups of columns that a figure shows, and points of one curve.
_GROUPS, _POINTS = 5, 4000
_INDEX = re.compile(r"^(.*?)(?:\[?(\d+)\]?)$")


def card(value: Recording) -> Card:
    """Size, time, and the columns with their ranges."""
    table = frame(value)
    facts = [("samples", str(len(table))), ("columns", str(table.width))]
    clock = _clock(table)
    if clock is not None and len(clock) > 1:
        step = float(np.median(np.diff(clock)))
        facts.append(("seconds", number(float(clock[-1] - clock[0]))))
        facts += [("rate", f"{number(1 / step)} Hz")] if step > 0 else []
    names = ", ".join(table.columns[:12]) + (", …" if table.width > 12 else "")
    said = [names]
    if value.mapping is not None:
        said.append("with units of its own")
    return Card(
        f"Recording “{value}”",
        tuple(said),
        "",
        tuple(facts),
        more=(("columns", _ranges(table)),),
        methods=(".plot()", ".to_frame()", "deltaid.check(robot, recording)"),
    )


def frame(value: Recording) -> pl.DataFrame:
    """All that it holds, in the units that it is in."""
    if isinstance(value.table, FrameTable):
        return value.table.frame
    header = list(value.table.header)
    parts = [np.column_stack([np.asarray(x) for x in rows.numbers]) for rows in
             value.table.rows(header)]  # fmt: skip
    return pl.DataFrame(np.concatenate(parts), schema=header)


def figure(value: Recording) -> "go.Figure":
    """Columns of numbers over time; those of one name in one plot: q1, q2, …; tau1, …."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    from deltaid.view import style

    table, clock = frame(value), _clock(frame(value))
    groups = dict[str, list[str]]()
    for name in table.columns:
        if table[name].dtype.is_numeric() and name not in TIMES:
            match = _INDEX.match(name)
            groups.setdefault(match[1] if match else name, []).append(name)
    shown = list(groups.items())[:_GROUPS]
    if not shown:
        return go.Figure()
    figure = make_subplots(rows=len(shown), cols=1, shared_xaxes=True, vertical_spacing=0.04)
    time = clock if clock is not None else np.arange(len(table), dtype=float)
    for row, (title, names) in enumerate(shown, 1):
        for k, name in enumerate(names):
            values = table[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
            x, y = _condensed(time, values)
            line = {"color": style.SERIES[k % len(style.SERIES)], "width": 1.2}
            figure.add_scatter(
                x=x, y=y, name=style.label(name), mode="lines", line=line, row=row, col=1
            )
        figure.update_yaxes(title_text=style.label(title), row=row, col=1)
    figure.update_xaxes(title_text="time [s]" if clock is not None else "row", row=len(shown))
    figure.update_layout(height=150 * len(shown) + 110)
    return figure


def _clock(table: pl.DataFrame) -> np.ndarray | None:
    """Time by its default names."""
    for name in TIMES:
        if name in table.columns and table[name].dtype.is_numeric():
            return table[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
    return None


def _condensed(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of many samples the least and the largest of each stretch, so that no spike disappears."""
    if len(values) <= _POINTS:
        return time.astype(np.float32), values.astype(np.float32)
    length = -(-2 * len(values) // _POINTS)
    starts = np.arange(0, len(values), length)
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    pairs = np.stack([low, high], axis=1).ravel()
    return np.repeat(time[starts], 2).astype(np.float32), pairs.astype(np.float32)


def _ranges(table: pl.DataFrame) -> Table:
    """Least and largest of every column."""
    rows = list[tuple[str, str, str]]()
    for name in table.columns:
        column = table[name]
        if column.dtype.is_numeric() and len(column.drop_nulls()):
            low, high = column.cast(pl.Float64).min(), column.cast(pl.Float64).max()
            rows.append((name, f"{low:.4g}", f"{high:.4g}"))
        else:
            rows.append((name, str(column.dtype), ""))
    return Table(("column", "least", "largest"), tuple(rows))
