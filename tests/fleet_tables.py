"""Tables of a fleet as `deltaid fleet` leaves them, drawn by chance for so many robots."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl

from deltaid.fleets.place import Place
from deltaid.fleets.site.site import write_site

Names = list[str]
Times = list[datetime]
Which = tuple[int, ...]
Random = np.random.Generator
START = datetime(2026, 1, 5, 6)
DRIVES = ("q1", "q2", "q3")
TYPES = ("irb360-6-1600", "clavel-delta3")
PARAMETERS = {"U.mcx": (0.42, "kg m"), "U.Izz": (0.11, "kg m²"), "EE.m": (1.3, "kg"),
              "S.m": (0.31, "kg"), "friction.viscous.q1": (0.24, "N m s/rad")}  # fmt: skip
LEVEL, LIMIT, ONSET = 2.0, 3.0, 10  # [N m], [N m], [weeks]
ALARMS = 0.1  # a robot and year, at most
BOUND = f"at most {ALARMS} a robot-year"


def name(k: int) -> str:
    """R001, R002, …"""
    return f"R{k + 1:03d}"


def write_tables(
    folder: Path, robots: int = 12, weeks: int = 20, *, rising: tuple[int, ...] = (2,),
    foreign: tuple[int, ...] = (5,), silent: tuple[int, ...] = (),
    names: dict[int, str] | None = None, per_week: int = 1,
) -> Path:  # fmt: skip
    """Tables in a folder.

    Args:
        rising: robots whose second drive has friction rising by 4 % a month from week 10 on.
        foreign: robots that do not belong to their type.
        silent: robots without any recording that could be used.
        names: of single robots, in place of R001.
    """
    rng = np.random.default_rng(1)
    named = [(names or {}).get(k, name(k)) for k in range(robots)]
    times = [START + timedelta(days=7 * k / per_week) for k in range(weeks * per_week)]
    warm = 35 + 5 * np.sin(np.arange(len(times)) / 4) + rng.normal(0, 1, len(times))
    usable = [k for k in range(robots) if k not in silent]
    tables = {
        "recordings": _recordings(named, times, warm, silent),
        "friction": _friction(named, times, warm, rising, usable, rng),
        "drift": _drift(named, times, rising, usable),
        "parameters": _parameters(named, times, usable, rng),
        "members": _members(named, foreign, usable, rng),
        "types": _types(robots),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for key, table in tables.items():
        table.write_parquet(folder / f"{key}.parquet")
    bad = tables["recordings"].filter(pl.col("reason") != "")
    quarantine = bad.select(
        pl.lit("recording").alias("what"), "robot", pl.col("path").alias("which"), "reason"
    )
    quarantine.write_csv(folder / "quarantine.csv")
    return folder


def write(folder: Path) -> Path:
    """The site of the tables in a folder; its first page."""
    tables = {path.stem: pl.read_parquet(path) for path in folder.glob("*.parquet")}
    quarantine = pl.read_csv(folder / "quarantine.csv", infer_schema=False)
    write_site({**tables, "quarantine": quarantine}, Place.named(folder))
    return folder / "site" / "index.html"


def changed(folder: Path, table: str, robot: str, only: str = "", **values: object) -> None:
    """Other values in a robot's rows of a table, or in those of one drive; None makes them null."""
    path = folder / f"{table}.parquet"
    frame = pl.read_parquet(path)
    own = pl.col("robot") == robot
    own &= pl.col("drive") == only if only else True
    frame.with_columns(
        pl.when(own).then(pl.lit(value, frame.schema[key])).otherwise(pl.col(key)).alias(key)
        for key, value in values.items()
    ).write_parquet(path)


def kind(k: int) -> str:
    """The type of robot k."""
    return TYPES[k % len(TYPES)]


def _recordings(named: Names, times: Times, warm: np.ndarray, silent: Which) -> pl.DataFrame:
    rows = []
    for k, robot in enumerate(named):
        for i, time in enumerate(times):
            bad = k in silent or (i + 3 * k) % 29 == 28
            reason = f"{time:%Y%m%d}.parquet: drive q2: no such column" if bad else ""
            rows.append((robot, kind(k), time, f"s3://plant/{robot}/{time:%Y%m%d}.parquet", 0.5,
                         warm[i], "" if bad else f"factors/{robot}/{time:%Y%m%d}.parquet", reason,
                         None if bad else 120_000, "noise" if i % 17 == 4 else ""))  # fmt: skip
    names = ("robot", "type", "time", "path", "load", "temperature", "file", "reason", "samples",
             "verdicts")  # fmt: skip
    return pl.DataFrame(rows, schema=names, orient="row")


def _friction(
    named: Names, times: Times, warm: np.ndarray, rising: Which, usable: list[int], rng: Random
) -> pl.DataFrame:
    rows = []
    for k in usable:
        for d, drive in enumerate(DRIVES):
            own = LEVEL * (1 + 0.1 * rng.normal())
            for i, time in enumerate(times):
                since = max((time - START).days - 7 * ONSET, 0) / 30.4
                grown = 1 + 0.04 * since * (k in rising and d == 1)
                value = own * grown * (1 - 0.004 * (warm[i] - 35)) * (1 + 0.01 * rng.normal())
                rows.append((named[k], drive, time, f"{time:%Y%m%d}.parquet", "friction", value,
                             0.02, "N m", warm[i], 0.5))  # fmt: skip
    names = ("robot", "drive", "time", "recording", "quantity", "value", "std", "unit",
             "temperature", "load")  # fmt: skip
    return pl.DataFrame(rows, schema=names, orient="row")


def _drift(named: Names, times: Times, rising: Which, usable: list[int]) -> pl.DataFrame:
    rows = []
    for k in usable:
        for d, drive in enumerate(DRIVES):
            if k in rising and d == 1:
                change = START + timedelta(weeks=ONSET)
                found = ("rising", change, change - timedelta(9), change + timedelta(11), 0.04,
                         0.031, 0.049, None, None, None, LIMIT, times[-1] + timedelta(140),
                         times[-1] + timedelta(100), times[-1] + timedelta(200))  # fmt: skip
                why = "friction rises by 4.0 % a month since 2026-03-16"
            else:
                found = (
                    "steady", None, None, None, 0.0, -0.004, 0.004, None, None, None, LIMIT, None,
                    None, None,
                )  # fmt: skip
                why = "no change is more likely than chance"
            rows.append((named[k], drive, *found, -0.004, -0.0047, -0.0033, LEVEL, "N m",
                         len(times), ALARMS, BOUND, why))  # fmt: skip
    kinds = {"robot": pl.String, "drive": pl.String, "state": pl.String}
    kinds |= dict.fromkeys(("change", "change_low", "change_high"), pl.Datetime)
    kinds |= dict.fromkeys(("rate", "rate_low", "rate_high"), pl.Float64)
    kinds |= dict.fromkeys(("step", "step_low", "step_high", "limit"), pl.Float64)
    kinds |= dict.fromkeys(("horizon", "horizon_low", "horizon_high"), pl.Datetime)
    slopes = ("temperature_slope", "temperature_slope_low", "temperature_slope_high", "level")
    kinds |= dict.fromkeys(slopes, pl.Float64)
    kinds |= {"unit": pl.String, "recordings": pl.Int64}
    kinds |= {"false_alarms": pl.Float64, "bound": pl.String, "reason": pl.String}
    return pl.DataFrame(rows, schema=kinds, orient="row")


def _parameters(named: Names, times: Times, usable: list[int], rng: Random) -> pl.DataFrame:
    rows = []
    periods = [*sorted({f"{time:%Y-%m}" for time in times}), "all"]
    for k in usable:
        for period in periods:
            many = len(times) if period == "all" else 4
            for parameter, (mean, unit) in PARAMETERS.items():
                std, by_data = 0.01 * mean, parameter != "S.m"
                value = mean * (1 + 0.02 * rng.normal()) if by_data else mean
                rows.append((named[k], kind(k), period, many, parameter, value, std,
                             value - 2 * std, value + 2 * std, unit, mean,
                             "data" if by_data else "prior", 0.05,
                             0.03 + 0.01 * rng.random(), ""))  # fmt: skip
    names = ("robot", "type", "period", "recordings", "parameter", "value", "std", "low", "high",
             "unit", "prior", "decided_by", "noise", "worst_error", "verdicts")  # fmt: skip
    return pl.DataFrame(rows, schema=names, orient="row")


def _members(named: Names, foreign: Which, usable: list[int], rng: Random) -> pl.DataFrame:
    rows = []
    for k in usable:
        for parameter, (mean, unit) in PARAMETERS.items():
            away = 9.0 if k in foreign and parameter == "EE.m" else rng.normal()
            value, std = mean * (1 + 0.02 * away), 0.008 * mean
            why = "EE.m is 9 spreads more than in the type" if k in foreign else ""
            rows.append((named[k], kind(k), parameter, value, std, value - 2 * std,
                         value + 2 * std, 2 * std, value - mean, unit,
                         k not in foreign, why))  # fmt: skip
    names = ("robot", "type", "parameter", "value", "std", "low", "high", "alone_std", "deviation",
             "unit", "belongs", "reason")  # fmt: skip
    return pl.DataFrame(rows, schema=names, orient="row")


def _types(robots: int) -> pl.DataFrame:
    rows = [
        (kind, parameter, mean, 0.004 * mean, 0.992 * mean, 1.008 * mean, 0.02 * mean, 0.015 * mean,
         0.03 * mean, unit, mean, len(range(k, robots, len(TYPES))), "")
        for k, kind in enumerate(TYPES)
        for parameter, (mean, unit) in PARAMETERS.items()
    ]  # fmt: skip
    names = ("type", "parameter", "mean", "std", "low", "high", "spread", "spread_low",
             "spread_high", "unit", "prior", "robots", "remarks")  # fmt: skip
    return pl.DataFrame(rows, schema=names, orient="row")
