"""Drift as tidy tables, for any dashboard, and as a few lines of text."""

from dataclasses import astuple
from datetime import datetime
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.errors import DeltaidError
from deltaid.files import write_bytes
from deltaid.fleets.drift_findings import Between, DriftFinding
from deltaid.fleets.robot_drift import RobotDrift
from deltaid.model.verdict import plus_minus
from deltaid.view.numbers import number
from deltaid.view.page import Table

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
# Suffixes of a number and the ends of its interval.
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


def friction_table(robot: RobotDrift) -> pl.DataFrame:
    """Friction of each recording: coefficients of each drive's law, and its mean."""
    friction, unknowns = robot.friction, robot.friction.unknowns
    std = np.sqrt(np.maximum(np.einsum("nuu->un", friction.covariance), 0.0))
    means = zip(robot.drives, friction.mean, friction.std, robot.units, strict=True)
    series = [(drive, "friction", *values) for drive, *values in means]
    terms = zip(
        unknowns.names, unknowns.drives, friction.values.T, std, unknowns.units, strict=True
    )
    series += [
        (robot.drives[drive], name.partition(".")[0], *values, unit)
        for name, drive, *values, unit in terms
        if drive >= 0
    ]
    rows = [
        (robot.robot, drive, recording.time, recording.label, quantity, value[n], std[n], unit,
         recording.degrees, recording.held)
        for n, recording in enumerate(robot.recordings)
        for drive, quantity, value, std, unit in series
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=FRICTION, orient="row").with_columns(
        pl.col("temperature").fill_nan(None)
    )


def drift_table(robot: RobotDrift) -> pl.DataFrame:
    tool = (robot.date(robot.tools[-1].day), robot.tools[-1].mass) if robot.tools else (None, None)
    rows = [
        (robot.robot, drive, finding.state, *robot.dates(finding.change),
         *astuple(finding.rate), *astuple(finding.step), finding.limit,
         *robot.dates(finding.horizon), *astuple(finding.temperature), finding.level,
         unit, finding.recordings, finding.scatter, finding.R, finding.threshold, robot.bound,
         *tool, finding.reason)
        for drive, unit, finding in zip(robot.drives, robot.units, robot.findings, strict=True)
    ]  # fmt: skip
    return pl.DataFrame(rows, schema=DRIFT, orient="row").with_columns(
        pl.col("level").fill_nan(None)
    )


def require_table(path: Path) -> None:
    """Refuse a file name with another ending, before any work.

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


_COLUMNS = ("drive", "state", "friction", "since", "% a month", "limit on", "% per K")


def drift_shown(drift: RobotDrift) -> Table:
    first, last = drift.recordings[0].time, drift.recordings[-1].time
    rows = list[tuple[str, ...]]()
    for drive, finding, unit in zip(drift.drives, drift.findings, drift.units, strict=True):
        change, horizon, slope = finding.change.value, finding.horizon, finding.temperature.value
        limit = "passed" if horizon.low is None else _date(drift.date(horizon.value))
        step = finding.step.value if finding.state == "stepped" else None
        rows.append(
            (
                drive,
                finding.state,
                f"{number(finding.level)} {unit}" if finding.level == finding.level else "unknown",
                "" if change is None else _date(drift.date(change)),
                _percent(finding.rate) if step is None else f"{100 * step:+.2g} % at once",
                "" if horizon.value is None else limit,
                "" if slope is None else f"{100 * slope:+.2f}",
            )
        )
    return Table(
        _COLUMNS,
        tuple(rows),
        "",
        title=f"{drift.robot}: {len(drift.recordings)} recordings, {first:%Y-%m-%d} to "
        f"{last:%Y-%m-%d}",
    )


def sentences(drift: RobotDrift) -> list[str]:
    """Reasons of findings, tool changes, and the bound of false alarms."""
    changes = [
        f"{drive}: {text}"
        for drive, finding in zip(drift.drives, drift.findings, strict=True)
        if finding.state != "steady" and (text := _details(drift, finding))
    ]
    tools = [
        f"what the robot holds became {'heavier' if tool.mass > 0 else 'lighter'} by "
        f"{plus_minus(abs(tool.mass), 2 * tool.std)} kg on {_date(drift.date(tool.day))}, "
        "undeclared; it is not counted as friction"
        for tool in drift.tools
    ]
    common = [] if drift.common is None else [drift.common]
    return [*changes, *tools, *common, f"false alarms: {drift.bound}"]


def _details(drift: RobotDrift, finding: DriftFinding) -> str:
    horizon, limit = finding.horizon, finding.limit
    parts = (
        "" if finding.change.value is None else f"since {_between(drift, finding.change)}",
        ""
        if horizon.value is None or horizon.low is None or limit is None
        else f"friction of {number(limit)} is reached on {_between(drift, horizon)}",
        finding.reason,
    )
    return "; ".join(filter(None, parts))


def _between(drift: RobotDrift, days: Between) -> str:
    middle, low, high = drift.dates(days)
    return f"{_date(middle)} (95 %: {_date(low)} to {_date(high)})"


def _date(day: datetime | None) -> str:
    return "unknown" if day is None else f"{day:%Y-%m-%d}"


def _percent(share: Between) -> str:
    if share.value is None or share.low is None or share.high is None:
        return "unknown"
    return f"{100 * share.value:+.2f} ({100 * share.low:+.2f}…{100 * share.high:+.2f})"
