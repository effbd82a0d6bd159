"""The tables of a fleet's folder as its site reads them; what is missing is empty, with a word."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from deltaid.errors import DeltaidError
from deltaid.fleets.belonging import LEAST

_TIME = pl.Datetime("us")
_TEXT, _NUMBER = pl.String, pl.Float64
# Columns that pages read, by table; further ones are left alone.
_COLUMNS: dict[str, dict[str, Any]] = {
    "recordings": {
        **dict.fromkeys(("robot", "type"), _TEXT), "time": _TIME, "path": _TEXT,
        **dict.fromkeys(("load", "temperature"), _NUMBER), "file": _TEXT, "reason": _TEXT,
        "samples": pl.Int64, "verdicts": _TEXT,
    },
    "quarantine": dict.fromkeys(("what", "robot", "which", "reason"), _TEXT),
    "parameters": {
        **dict.fromkeys(("robot", "type", "period"), _TEXT), "recordings": pl.Int64,
        "parameter": _TEXT, **dict.fromkeys(("value", "std", "low", "high"), _NUMBER),
        "unit": _TEXT, "prior": _NUMBER, "decided_by": _TEXT, "noise": _NUMBER,
        "worst_error": _NUMBER, "verdicts": _TEXT,
    },
    "friction": {
        **dict.fromkeys(("robot", "drive"), _TEXT), "time": _TIME, "quantity": _TEXT,
        **dict.fromkeys(("value", "std"), _NUMBER), "unit": _TEXT, "temperature": _NUMBER,
    },
    "drift": {
        **dict.fromkeys(("robot", "drive", "state"), _TEXT),
        **dict.fromkeys(("change", "change_low", "change_high"), _TIME),
        **dict.fromkeys(("rate", "rate_low", "rate_high", "step", "step_low", "step_high", "limit"),
                        _NUMBER),
        **dict.fromkeys(("horizon", "horizon_low", "horizon_high"), _TIME),
        **dict.fromkeys(("temperature_slope", "level"), _NUMBER), "unit": _TEXT,
        "recordings": pl.Int64, "false_alarms": _NUMBER, "bound": _TEXT, "reason": _TEXT,
    },
    "types": {
        **dict.fromkeys(("type", "parameter"), _TEXT),
        **dict.fromkeys(("mean", "std", "low", "high", "spread", "spread_low", "spread_high"),
                        _NUMBER),
        "unit": _TEXT, "prior": _NUMBER, "robots": pl.Int64, "told": _TEXT,
    },
    "members": {
        **dict.fromkeys(("robot", "type", "parameter"), _TEXT),
        **dict.fromkeys(("value", "std", "low", "high", "alone_std", "deviation"), _NUMBER),
        "unit": _TEXT, "belongs": pl.Boolean, "reason": _TEXT,
    },
}  # fmt: skip
COLUMNS = {name: pl.Schema(columns) for name, columns in _COLUMNS.items()}
# Of which nothing is said where they are missing.
_FURTHER = ("step", "step_low", "step_high", "bound", "told")
_SHOWS = {
    "recordings": "recordings and their verdicts",
    "quarantine": "fits that failed",
    "parameters": "parameters over time",
    "friction": "friction over time",
    "drift": "changes of friction, rates and horizons",
    "types": "means and spreads of types",
    "members": "which robots do not belong to their type",
}


@dataclass(frozen=True)
class Tables:
    """Tables of a fleet; one that is missing has its columns and no row.

    Attributes:
        folder: where they lie.
        absent: names of those that are missing.
        words: what is left out for it, in sentences.
        members: has `spreads` besides, deviations in spreads between robots.
    """

    folder: Path
    recordings: pl.DataFrame
    quarantine: pl.DataFrame
    parameters: pl.DataFrame
    friction: pl.DataFrame
    drift: pl.DataFrame
    types: pl.DataFrame
    members: pl.DataFrame
    absent: frozenset[str]
    words: tuple[str, ...]


def read_tables(folder: Path) -> Tables:
    """All tables of a folder.

    Raises:
        DeltaidError: there is none, or one of them cannot be read.
    """
    frames, absent, words = dict[str, pl.DataFrame](), set[str](), list[str]()
    for name, columns in COLUMNS.items():
        path = folder / f"{name}.{'csv' if name == 'quarantine' else 'parquet'}"
        if not path.is_file():
            absent.add(name)
            words.append(f"{path.name} is missing, so this site does not show {_SHOWS[name]}.")
            frames[name] = pl.DataFrame(schema=columns)
            continue
        frame = _read(path)
        without = [column for column in columns if column not in (*frame.columns, *_FURTHER)]
        if without:
            words.append(f"{path.name} has no column {', '.join(without)}; it is left out.")
        frames[name] = _shaped(frame, columns, path)
    if len(absent) == len(COLUMNS):
        raise DeltaidError(
            "has no table of a fleet",
            where=str(folder),
            cure="give the folder that `deltaid fleet MANIFEST -o FOLDER` has filled",
        )
    frames["members"] = _in_spreads(frames["members"], frames["types"])
    return Tables(folder, **frames, absent=frozenset(absent), words=tuple(words))


def _in_spreads(members: pl.DataFrame, types: pl.DataFrame) -> pl.DataFrame:
    """Members with their deviations in spreads between robots too, null where none is known.

    Whether a robot belongs is null where too few others could tell.
    """
    spreads = types.select("type", "parameter", "spread").unique(["type", "parameter"])
    joined = members.join(spreads, on=["type", "parameter"], how="left", maintain_order="left")
    spread = pl.when(pl.col("spread") > 0).then(pl.col("spread"))
    enough = pl.col("robot").n_unique().over("type") >= LEAST
    return joined.with_columns(
        spreads=pl.col("deviation") / spread, belongs=pl.when(enough).then(pl.col("belongs"))
    ).drop("spread")


def _read(path: Path) -> pl.DataFrame:
    try:
        if path.suffix == ".csv":
            return pl.read_csv(path, infer_schema=False)
        return pl.read_parquet(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise DeltaidError(
            f"cannot be read: {str(error).splitlines()[0]}",
            where=str(path),
            cure="remove it and call `deltaid fleet` again, which makes it anew",
        ) from None


def _shaped(frame: pl.DataFrame, columns: Mapping[str, Any], path: Path) -> pl.DataFrame:
    """The columns that are read, in their types; texts are never null, times are in UTC."""
    there = {
        name: pl.col(name) if name in frame.columns else pl.lit(None).alias(name)
        for name in columns
    }
    for name, given in frame.schema.items():
        if name in there and isinstance(given, pl.Datetime) and given.time_zone:
            there[name] = pl.col(name).dt.convert_time_zone("UTC").dt.replace_time_zone(None)
    try:
        return frame.select(
            there[name].cast(kind).fill_null("") if kind == _TEXT else there[name].cast(kind)
            for name, kind in columns.items()
        )
    except pl.exceptions.PolarsError as error:
        raise DeltaidError(
            f"holds what it should not: {str(error).splitlines()[0]}",
            where=str(path),
            cure="remove it and call `deltaid fleet` again, which makes it anew",
        ) from None
