"""Recordings in memory: tables of polars or pandas, and arrays."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from deltaid.errors import RecordingError, typed
from deltaid.forked import require_threads
from deltaid.mechanism.one_or_many import numbered
from deltaid.recording.arrays import (
    Units,
    columns_of,
    copied,
    extra_columns,
    numbers_of,
    require_shapes,
    time_of,
    units_of,
)
from deltaid.recording.formats.frames import FrameTable, fields_of
from deltaid.recording.source import LogTable, damage
from deltaid.shown import Plotted, Shown, Tabled


@runtime_checkable
class PandasTable(Protocol):
    """The part of a `pandas.DataFrame` that is used; pandas itself is not needed."""

    @property
    def columns(self) -> Any: ...
    @property
    def iloc(self) -> Any: ...
    @property
    def index(self) -> Any: ...


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown, Plotted, Tabled):
    """A recording in memory, which can replace a log file.

    `Recording.from_arrays` makes one from arrays, `Recording.from_table` from a table with a name.
    It is raw data; `Identification.recordings` are checked logs with their filters
    (`deltaid.recording.recording.PreparedRecording`).

    Attributes:
        table: the numbers, with the units that were given.
        drives: number of drives of the arrays; None for a table.
    """

    table: LogTable
    drives: int | None = None

    def __str__(self) -> str:
        return str(self.table.path)

    @classmethod
    def from_table(cls, table: "TableLike", *, name: str = "table") -> "Recording":
        """Recording from a table, with a name for messages and reports.

        Columns are named as in a log file: t, q1…, tau1…, or as the mapping states. A lazy table is
        computed. The columns of a pandas table are copied, and its index if that has a name or
        holds times. A dictionary of arrays or a structured array of NumPy is a table too; columns
        of an array such as q of shape (samples, drives) are q[0], q[1], ….

        Raises:
            RecordingError: two columns have one name, their lengths differ, they hold no numbers,
                or a lazy table cannot be computed.
        """
        if isinstance(table, pl.LazyFrame):
            require_threads()
            why = "cannot be computed", "collect() it to see why"
            with damage(name, pl.exceptions.PolarsError, *why):
                table = table.collect()
        if isinstance(table, Mapping | np.ndarray):
            table = pl.DataFrame(columns_of(table, name))
        frame = table if isinstance(table, pl.DataFrame) else _from_pandas(table, name)
        return cls(_table(frame, name, {}))

    @classmethod
    def from_arrays(
        cls,
        *,
        q: ArrayLike,
        t: ArrayLike | None = None,
        rate: float | None = None,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        unit_t: str | None = None,
        unit_q: Units | None = None,
        unit_qd: Units | None = None,
        unit_qdd: Units | None = None,
        unit_tau: Units | None = None,
        extra: Mapping[str, ArrayLike] | None = None,
        name: str = "arrays",
    ) -> "Recording":
        """Recording from arrays, which are copied.

        Units are written as in a mapping file, such as "deg", "rpm", "mN*m" or, for per mille of
        23.5 N m, "0.0235 N*m": one for all drives, or a sequence of one per drive. By default
        numbers are in s and rad, rad/s, rad/s², N m at the joint, or m, m/s, m/s², N. Columns that
        a mapping names have its units.

        Args:
            q: positions, (samples, drives).
            qd: velocities, the same shape.
            qdd: accelerations, the same shape.
            tau: torques or forces, the same shape.
            t: time, (samples,).
            rate: sampling rate [Hz], in place of t.
            extra: extra columns by the names in a mapping, such as the state of a gripper,
                (samples,); or the channels of a sensor by its name, (samples, channels).
            name: name of the recording, for messages and reports.

        Raises:
            RecordingError: shapes do not fit, an array holds no numbers, or neither or both of t
                and rate are given. Values and units are checked when the recording is used.
        """
        typed("name", name, str, "the name of the recording")
        given = {"q": q, "qd": qd, "qdd": qdd, "tau": tau}
        arrays = {
            key: numbers_of(value, f"{name}, {key}")
            for key, value in given.items()
            if value is not None
        }
        require_shapes(arrays, name)
        samples, drives = arrays["q"].shape
        columns = {"t": time_of(t, rate, unit_t, samples, name)}
        columns |= {key: copied(column) for key, column in numbered(**arrays).items()}
        columns |= extra_columns(extra or {}, samples, columns, name)
        stated = {"q": unit_q, "qd": unit_qd, "qdd": unit_qdd, "tau": unit_tau}
        units = units_of(stated, unit_t, arrays, name)
        return cls(_table(pl.DataFrame(columns), name, units), drives)


# A table of polars or pandas, a dictionary of arrays, or a structured array of NumPy.
TableLike = pl.DataFrame | pl.LazyFrame | PandasTable | Mapping[str, Any] | np.ndarray
RecordingLike = str | Path | TableLike | Recording


def as_source(given: object, name: str = "table") -> Path | Recording:
    """Source of a recording: a path, or a recording in memory.

    Args:
        name: name for a table.

    Raises:
        RecordingError: `given` is no recording.
        DeltaidError: the process has lost its threads (`require_threads`).
    """
    require_threads()
    if isinstance(given, Recording):
        return given
    if isinstance(given, str | Path):
        return Path(given)
    if isinstance(given, Tabled) and hasattr(given, "run"):  # a planned motion
        given = given.to_frame()
    if isinstance(given, pl.DataFrame | pl.LazyFrame | PandasTable | Mapping | np.ndarray):
        return Recording.from_table(given, name=name)
    raise RecordingError(
        f"a {type(given).__name__} is no recording",
        where="logs",
        cure="give a path, a table of polars or pandas, a dictionary of arrays such as "
        "{'t': t, 'q': q, 'tau': tau}, or deltaid.Recording.from_arrays(…)",
    )


def as_sources(given: object) -> list[Path | Recording]:
    """Sources of one or several recordings; tables of a sequence are numbered.

    Raises:
        RecordingError: one of them is no recording.
    """
    if not isinstance(given, Sequence) or isinstance(given, str):
        return [as_source(given)]
    several = len(given) > 1
    return [as_source(log, f"table {i + 1}" if several else "table") for i, log in enumerate(given)]


def _table(frame: pl.DataFrame, name: str, units: dict[str, str]) -> FrameTable:
    if not Path(name).name:
        raise RecordingError(
            f"'{name}' is no name of a recording", where="name", cure="give it a word"
        )
    return FrameTable(Path(name), fields_of(frame.lazy()), frame, units=units)


def _from_pandas(table: PandasTable, name: str) -> pl.DataFrame:
    columns: dict[str, pl.Series] = {}
    for k, key in enumerate(map(str, table.columns)):
        if key in columns:
            raise RecordingError(
                f"has several columns called {key}", where=name, cure="rename all but one"
            )
        columns[key] = _series(key, table.iloc[:, k])
    key = _index_name(table)
    if key and key not in columns:
        columns = {key: _series(key, table.index.to_series())} | columns
    return pl.DataFrame(columns)


def _index_name(table: PandasTable) -> str:
    """Name of the index as a column: its own, or t if it holds dates, durations or numbers with a
    point; empty if it is no column."""
    index, names = table.index, {*map(str, table.columns)}
    if index.name is not None:
        return str(index.name)
    times = index.nlevels == 1 and index.dtype.kind in "mMf" and not names & {"t", "time"}
    return "t" if times else ""


def _series(key: str, column: Any) -> pl.Series:
    if hasattr(column, "cat"):
        column = column.astype(column.cat.categories.dtype)
    kind = column.dtype.kind
    if kind == "b":
        truths = column.to_numpy(dtype=object, na_value=None).tolist()
        return pl.Series(key, truths, dtype=pl.Boolean)
    if kind in "iuf":
        return pl.Series(key, copied(column.to_numpy(dtype=np.float64, na_value=math.nan)))
    if kind in "mM":
        if getattr(column.dtype, "tz", None) is not None:
            column = column.dt.tz_convert("UTC").dt.tz_localize(None)
        return pl.Series(key, column.to_numpy(dtype=f"{kind}8[ns]"))
    objects = column if kind == "O" else ()
    first = next((value for value in objects if value is not None), None)
    if isinstance(first, list | tuple | np.ndarray):
        try:
            return pl.Series(key, np.stack([numbers_of(row, key) for row in column]))
        except (RecordingError, ValueError):
            pass  # no numbers, or rows of different lengths
    elif isinstance(first, str):
        texts = [text if isinstance(text, str) else None for text in column]
        return pl.Series(key, texts, dtype=pl.String)
    if isinstance(first, Real):
        numbers = [float(x) if isinstance(x, Real) else math.nan for x in column]
        return pl.Series(key, numbers, dtype=pl.Float64)
    return pl.repeat(None, len(column), dtype=pl.String, eager=True)
