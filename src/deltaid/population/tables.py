"""A type and its robots as tidy tables."""

import numpy as np
import polars as pl

from deltaid.population.result import Population

TYPES = {
    "type": pl.String,
    "parameter": pl.String,
    "mean": pl.Float64,
    "std": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "spread": pl.Float64,
    "spread_low": pl.Float64,
    "spread_high": pl.Float64,
    "unit": pl.String,
    "prior": pl.Float64,
    "robots": pl.Int64,
    "told": pl.String,
}
MEMBERS = {
    "robot": pl.String,
    "type": pl.String,
    "parameter": pl.String,
    "value": pl.Float64,
    "std": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
    "alone_std": pl.Float64,
    "deviation": pl.Float64,
    "unit": pl.String,
    "belongs": pl.Boolean,
    "reason": pl.String,
    "chance": pl.Float64,
}


def types_table(name: str, found: Population) -> pl.DataFrame:
    """A row a parameter that the fit may change: the type's mean, and the spread between robots,
    null where it cannot be known."""
    robots = sum(one.belongs for one in found.members)
    rows = []
    for k in np.flatnonzero(found.free):
        one, value, half = found.layout.parameters[k], found.mean.value[k], found.mean.half[k]
        spread = (found.spread[k], found.spread_low[k], found.spread_high[k])
        rows.append(
            (name, one.name, value, found.mean.std[k], max(value - half, one.low), value + half,
             *(float(x) if np.isfinite(x) else None for x in spread), one.unit, one.prior, robots,
             "; ".join(found.told))
        )  # fmt: skip
    return pl.DataFrame(rows, schema=TYPES, orient="row")


def members_table(name: str, found: Population) -> pl.DataFrame:
    """A row a robot and parameter; of robots that do not belong by themselves alone."""
    rows = []
    for robot in found.members:
        for k in np.flatnonzero(found.free):
            one, value, half = (
                found.layout.parameters[k],
                robot.within.value[k],
                robot.within.half[k],
            )
            rows.append(
                (robot.name, name, one.name, value, robot.within.std[k], max(value - half, one.low),
                 value + half, robot.alone_std[k], value - found.mean.value[k], one.unit,
                 robot.belongs, robot.reason, robot.chance)
            )  # fmt: skip
    return pl.DataFrame(rows, schema=MEMBERS, orient="row")
