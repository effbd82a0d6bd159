"""Drift as tidy tables, one row a fact, for whatever dashboard there is."""

from collections.abc import Iterable, Sequence
from datetime import datetime
from io import BytesIO
from pathlib import Path

import polars as pl

from deltaid.drift.findings import Between
from deltaid.drift.robot_drift import RobotDrift
from deltaid.errors import DeltaidError
from deltaid.files import write_bytes

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
DRIFT = {
    "robot": pl.String,
    "drive": pl.String,
    "state": pl.String,
    "change": _TIME,
    "change_low": _TIME,
    "change_high": _TIME,
    "rate": pl.Float64,
    "rate_low": pl.Float64,
    "rate_high": pl.Float64,
    "step": pl.Float64,
    "step_low": pl.Float64,
    "step_high": pl.Float64,
    "limit": pl.Float64,
    "horizon": _TIME,
    "horizon_low": _TIME,
    "horizon_high": _TIME,
    "temperature_slope": pl.Float64,
    "temperature_slope_low": pl.Float64,
    "temperature_slope_high": pl.Float64,
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


def friction_table(found: Iterable[RobotDrift]) -> pl.DataFrame:
    """Friction of each recording: coefficients of each drive's law, and its mean."""
    rows = list[tuple[object, ...]]()
    for one in found:
        mean, std, unknowns = one.friction.mean, one.friction.std, one.friction.unknowns
        terms = {term.name: term.unit for term in _terms(one)}
        for n, (day, recording) in enumerate(zip(one.friction.days, one.recordings, strict=True)):
            head = (recording.time, recording.label)
            tail = (_known(recording.degrees), recording.held)
            for i, drive in enumerate(one.drives):
                rows.append((one.robot, drive, *head, "friction", float(mean[i, n]),
                             float(std[i, n]), one.units[i], *tail))  # fmt: skip
            for k, name in enumerate(unknowns.names):
                if unknowns.drives[k] >= 0:
                    deviation = float(max(day.covariance[k, k], 0.0) ** 0.5)
                    rows.append((one.robot, one.drives[unknowns.drives[k]], *head,
                                 name.partition(".")[0], float(day.values[k]), deviation,
                                 terms[name], *tail))  # fmt: skip
    return pl.DataFrame(rows, schema=FRICTION, orient="row")


def drift_table(found: Iterable[RobotDrift]) -> pl.DataFrame:
    """What is said of each drive."""
    rows = [row for one in found for row in _rows(one)]
    return pl.DataFrame(rows, schema=DRIFT, orient="row")


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
    if path.suffix.lower() == ".csv":
        table.write_csv(buffer)
    else:
        table.write_parquet(buffer, compression="zstd")
    write_bytes(path, buffer.getvalue())


def _rows(one: RobotDrift) -> Sequence[tuple[object, ...]]:
    last = one.tools[-1] if one.tools else None
    tool: tuple[datetime | None, float | None] = (
        (None, None) if last is None else (one.date(last.day), last.mass)
    )
    return [
        (
            one.robot, drive, own.state, *one.dates(own.change), *_three(own.rate),
            *_three(own.step), own.limit, *one.dates(own.horizon), *_three(own.temperature),
            _known(own.level), one.units[i], own.recordings, own.scatter, own.R, own.threshold,
            one.bound, *tool, own.reason,
        )
        for i, (drive, own) in enumerate(zip(one.drives, one.findings, strict=True))
    ]  # fmt: skip


def _three(one: Between) -> tuple[float | None, float | None, float | None]:
    return one.value, one.low, one.high


def _known(value: float) -> float | None:
    return value if value == value else None


def _terms(one: RobotDrift):
    return one.recordings[0].file.record.robot.friction_terms
