"""A small recording in many spellings, and what the package reads from a file."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import RecordingError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import Motion, simulate_recording, surrogate_parameters
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.resolution import resolve_columns
from deltaid.recording.table import open_table, read_batches
from deltaid.robot.load import load_robot

DOF = 3
Spelling = Callable[[pl.DataFrame], bytes]


@cache
def recorded(samples: int = 1500, derivatives: bool = False, rate: float = 1000.0) -> pl.DataFrame:
    """Columns t, q1…, (qd1…, qdd1…,) tau1… of the three-drive robot without noise."""
    dynamics, motion, p, rng = _robot_and_motion()
    frame = simulate_recording(dynamics, p, motion, rng, duration=samples / rate, rate=rate)
    return frame if derivatives else frame.select(names("t", "q", "tau"))


def noisy(table: pl.DataFrame) -> pl.DataFrame:
    """With torques as sensors give them: without noise they look computed."""
    rng = np.random.default_rng(1)
    return table.with_columns(
        pl.col(f"tau{i}") + pl.Series(0.02 * rng.normal(size=len(table))) for i in (1, 2, 3)
    )


def true_parameters() -> np.ndarray:
    """Those of the robot that was recorded."""
    return _robot_and_motion()[2]


def _robot_and_motion() -> tuple[Dynamics, Motion, np.ndarray, np.random.Generator]:
    dynamics, rng = compiled(load_robot("clavel-delta3")), np.random.default_rng(5)
    motion = random_motion(dynamics.kinematics, rng, period=4.0)
    return dynamics, motion, surrogate_parameters(dynamics.robot, rng), rng


def names(*quantities: str) -> list[str]:
    """Default column names: 't' alone, the others with a number for each drive."""
    return [
        name
        for quantity in quantities
        for name in (["t"] if quantity == "t" else [f"{quantity}{i + 1}" for i in range(DOF)])
    ]


def tabled(**quantities: np.ndarray) -> pl.DataFrame:
    """Quantities, (samples,) or (samples, drives), with the default names of columns."""
    columns = dict[str, np.ndarray]()
    for name, x in quantities.items():
        columns |= {name: x} if x.ndim == 1 else {f"{name}{i + 1}": y for i, y in enumerate(x.T)}
    return pl.DataFrame(columns)


def arrays(frame: pl.DataFrame) -> dict[str, np.ndarray]:
    """Arguments of `from_arrays`."""
    found = {key: frame.select(names(key)).to_numpy() for key in ("q", "tau")}
    return {"t": frame["t"].to_numpy(), **found}


def text(
    frame: pl.DataFrame,
    separator: str = ",",
    *,
    header: list[str] | None = None,
    number: Callable[[float], str] = repr,
    eol: str = "\n",
) -> str:
    """A frame as CSV, numbers written by a function of one's own."""
    rows = [header or frame.columns]
    rows += [[number(v) if isinstance(v, float) else str(v) for v in row] for row in frame.rows()]
    return "".join(separator.join(row) + eol for row in rows)


def write(path: Path, content: str | bytes | pl.DataFrame) -> Path:
    """A log with that content; a frame in the format that the name asks for."""
    if isinstance(content, pl.DataFrame):
        content.write_parquet(path) if path.suffix == ".parquet" else content.write_csv(path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(path: Path, mapping: ColumnMapping | None = None) -> np.ndarray:
    """All rows of a log in SI units, columns as in `Columns.all`."""
    table = open_table(path, mapping)
    columns = resolve_columns(table, (False,) * DOF, mapping)
    batches = list(read_batches(table, columns))
    return np.concatenate(list(batches))


def refusal(call, *arguments) -> str:
    """The message of the RecordingError that a call raises."""
    with pytest.raises(RecordingError) as caught:
        call(*arguments)
    assert str(caught.value)[-1] != "."
    return str(caught.value)


def comma(value: float) -> str:
    """A number with decimal comma."""
    return repr(value).replace(".", ",")
