"""Cards of recordings, in memory and surveyed, and of mappings of their columns."""

import re

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.grouping import grouped
from deltaid.recording import recording
from deltaid.recording.formats.frames import FrameTable
from deltaid.recording.log import Log
from deltaid.recording.mapped_columns import QUANTITIES, TIMES, AllDrives, DriveColumn
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.view import style
from deltaid.view.comparison import POINTS, extreme_rows, stretch_length
from deltaid.view.models import warned
from deltaid.view.numbers import number
from deltaid.view.page import Table
from deltaid.view.show import Card

_INDEX = re.compile(r"\[?\d+\]?$")


def recording_card(value: Recording) -> Card:
    table, facts = recording_frame(value), dict[str, str]()
    if (clock := _clock(table)) is not None and len(clock) > 1:
        step = float(np.median(np.diff(clock)))
        facts["seconds"] = number(float(clock[-1] - clock[0]))
        facts |= {"rate": f"{number(1 / step)} Hz"} if step > 0 else {}
    names = ", ".join(table.columns[:12]) + (", …" if table.width > 12 else "")
    return Card(
        f"Recording “{value}”",
        (names, "with units of its own") if value.table.units else (names,),
        facts=(("samples", str(len(table))), ("columns", str(table.width)), *facts.items()),
        more=(("columns", Table(("column", "least", "largest"), tuple(map(_range, table)))),),
        methods=(".plot()", ".to_frame()", "deltaid.check(robot, recording)"),
    )


def recording_frame(value: Recording) -> pl.DataFrame:
    """All columns of a recording, in its own units."""
    if isinstance(value.table, FrameTable):
        return value.table.frame
    header = list(value.table.header)
    parts = [np.column_stack([np.asarray(x) for x in rows.numbers]) for rows in
             value.table.rows(header)]  # fmt: skip
    return pl.DataFrame(np.concatenate(parts), schema=header)


def recording_figure(value: Recording) -> go.Figure:
    """Numeric columns over time, one panel for columns of one name: q1, q2, …; tau1, …."""
    table = recording_frame(value)
    clock = _clock(table)
    numeric = [x.name for x in table if x.dtype.is_numeric() and x.name not in TIMES]
    shown = list(grouped((_INDEX.sub("", name), name) for name in numeric).items())[:5]
    if not shown:
        return go.Figure()
    titles = [style.label(title) for title, _ in shown]
    along = "time [s]" if clock is not None else "row"
    figure = style.stacked(titles, 150 * len(shown) + 110, spacing=0.04, time=along)
    time = clock if clock is not None else np.arange(len(table), dtype=float)
    for row, (_, names) in enumerate(shown, 1):
        for k, name in enumerate(names):
            values, rows = _numbers(table[name]), slice(None)
            if len(values) > POINTS:
                rows = extreme_rows(values, stretch_length(2 * len(values), POINTS))
            figure.add_scatter(
                x=time[rows].astype(np.float32),
                y=values[rows].astype(np.float32),
                name=style.label(name),
                mode="lines",
                line={"color": style.SERIES[k % len(style.SERIES)], "width": 1.2},
                row=row,
                col=1,
            )
    return figure


def _clock(table: pl.DataFrame) -> np.ndarray | None:
    name = next(
        (name for name in TIMES if name in table.columns and table[name].dtype.is_numeric()), None
    )
    return None if name is None else _numbers(table[name])


def _numbers(column: pl.Series) -> np.ndarray:
    return column.cast(pl.Float64).fill_null(np.nan).to_numpy()


def _range(column: pl.Series) -> tuple[str, str, str]:
    if not column.dtype.is_numeric() or not len(column.drop_nulls()):
        return column.name, str(column.dtype), ""
    numbers = column.cast(pl.Float64)
    return column.name, f"{numbers.min():.4g}", f"{numbers.max():.4g}"


def log_card(value: Log | recording.PreparedRecording) -> Card:
    log, cutoff = (value, None) if isinstance(value, Log) else (value.log, value.cutoff)
    warnings = tuple(str(text) for text in log.warnings)
    return Card(
        f"Recording {log.path.name}, surveyed",
        (*warnings, "nothing about it is doubtful")[:1],
        facts=(
            ("samples", str(log.samples)),
            ("rate", f"{number(log.rate)} Hz"),
            ("seconds", number(log.samples / log.rate)),
            *((("low-pass", f"{number(cutoff, 3)} Hz"),) if cutoff else ()),
            *((("stretches excluded", str(len(log.masks))),) if log.masks else ()),
        ),
        more=warned(warnings),
    )


def mapping_card(value: ColumnMapping) -> Card:
    """Columns with their units, without those of default names."""
    time = value.time
    unit = time.unit if time.rate is None else f"{time.rate:g} / s"
    facts = {"time": f"{time.rate:g} Hz" if time.is_absent else f"{time.column} [{unit}]"}
    for quantity in QUANTITIES:
        columns: AllDrives | tuple[DriveColumn, ...] | None = getattr(value, quantity)
        each = (columns,) if isinstance(columns, AllDrives) else columns or ()
        facts[quantity] = ", ".join(_described_column(column) for column in each)
    facts["sensors"] = ", ".join(value.sensors)
    facts["loads"] = ", ".join(load.name for load in value.loads)
    return Card("Mapping of columns", facts=tuple(x for x in facts.items() if x[1]), apart=True)


def _described_column(column: DriveColumn | AllDrives) -> str:
    """A column in words: 'tau2 [N m; sign -1]', its name, unit, and other conversions."""
    name = column.column or ", ".join(getattr(column, "columns", None) or ())
    more = [
        f"{key.replace('_', ' ')} {getattr(column, key)}"
        for key, usual in (("sign", 1), ("gear", 1.0), ("zero", 0.0), ("torque_constant", None))
        if getattr(column, key) not in (usual, None)
    ]
    return f"{name} [{'; '.join([str(column.unit), *more])}]"
