"""Drift as tidy tables, one row a fact, for whatever dashboard there is."""

from collections.abc import Iterable, Iterator
from dataclasses import astuple
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.errors import DeltaidError
from deltaid.files import write_bytes
from deltaid.fleets.robot_drift import RobotDrift

_TIME = pl.Datetime("us")
FRICTION = {
    "robot": pl.String,
    "drive": pl.String,
    "time": _TIME,
    "recording": pl.String,
    "quantity": pl.String,
    "value": pl.Float64,
    "std": pl.Float64,
    "unit": pl.String,
    "temperature": pl.Float64,
    "load": pl.Float64,
}
# Each a number with the ends of its interval.
_ENDS = ("", "_low", "_high")
DRIFT = {
    "robot": pl.String,
    "drive": pl.String,
    "state": pl.String,
    **{f"change{end}": _TIME for end in _ENDS},
    **{f"{name}{end}": pl.Float64 for name in ("rate", "step") for end in _ENDS},
    "limit": pl.Float64,
    **{f"horizon{end}": _TIME for end in _ENDS},
    **{f"temperature_slope{end}": pl.Float64 for end in _ENDS},
    "level": pl.Float64,
    "unit": pl.String,
    "recordings": pl.Int64,
    "scatter": pl.Float64,
    "evidence": pl.Float64,
    "threshold": pl.Float64,
    "false_alarms": pl.String,
    "tool_change": _TIME,
    "tool_mass": pl.Float64,
    "reason": pl.String,
}


def friction_table(robots: Iterable[RobotDrift]) -> pl.DataFrame:
    """Friction of each recording: coefficients of each drive's law, and its mean."""
    rows = list[tuple[object, ...]]()
    for robot in robots:
        friction, unknowns = robot.friction, robot.friction.unknowns
        terms = robot.recordings[0].file.record.robot.friction_terms
        units = {term.name: term.unit for term in terms}
        std = np.sqrt(np.maximum(np.einsum("nuu->un", friction.covariance), 0.0))
        means = zip(robot.drives, friction.mean, friction.std, robot.units, strict=True)
        series = [(drive, "friction", *values) for drive, *values in means]
        for name, drive, *values in zip(
            unknowns.names, unknowns.drives, friction.values.T, std, strict=True
        ):
            if drive >= 0:
                kind, _, _ = name.partition(".")
                series.append((robot.drives[drive], kind, *values, units[name]))
        rows += [
            (robot.robot, drive, recording.time, recording.label, quantity, value[n], std[n], unit,
             _known(recording.degrees), recording.held)
            for n, recording in enumerate(robot.recordings)
            for drive, quantity, value, std, unit in series
        ]  # fmt: skip
    return pl.DataFrame(rows, schema=FRICTION, orient="row")


def drift_table(robots: Iterable[RobotDrift]) -> pl.DataFrame:
    """The finding on each drive."""
    rows = [row for robot in robots for row in _rows(robot)]
    return pl.DataFrame(rows, schema=DRIFT, orient="row")


def _rows(robot: RobotDrift) -> Iterator[tuple[object, ...]]:
    tool = (robot.date(robot.tools[-1].day), robot.tools[-1].mass) if robot.tools else (None, None)
    for drive, unit, own in zip(robot.drives, robot.units, robot.findings, strict=True):
        yield (
            robot.robot, drive, own.state, *robot.dates(own.change), *astuple(own.rate),
            *astuple(own.step), own.limit, *robot.dates(own.horizon), *astuple(own.temperature),
            _known(own.level), unit, own.recordings, own.scatter, own.R, own.threshold,
            robot.bound, *tool, own.reason,
        )  # fmt: skip


def _known(value: float) -> float | None:
    return value if value == value else None


def require_table(path: Path) -> None:
    """Refuse a name before any work.

    Raises:
        DeltaidError: it ends in neither .parquet nor .csv.
    """
    if path.suffix.lower() not in (".parquet", ".csv"):
        raise DeltaidError("must end in .parquet or .csv", where=str(path))


def save(table: pl.DataFrame, path: Path) -> None:
    """Write a table, whole or not at all.

    Raises:
        DeltaidError: its name ends in neither .parquet nor .csv, or it cannot be written.
    """
    require_table(path)
    buffer = BytesIO()
    write = table.write_csv if path.suffix.lower() == ".csv" else table.write_parquet
    write(buffer)
    write_bytes(path, buffer.getvalue())
