"""State of each robot from the tables, and reasons to inspect it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import IntEnum
from itertools import pairwise, takewhile
from statistics import median
from typing import Any

import polars as pl

from deltaid.errors import quoted
from deltaid.estimation.scatter import NORMAL
from deltaid.fleets.belonging import LEAST
from deltaid.fleets.fleet import ALL
from deltaid.view.numbers import percent

Row = Mapping[str, Any]
Tables = Mapping[str, pl.DataFrame]
# A limit within this time needs action.
_SOON = timedelta(days=28)
# So many recordings in a row that end alike concern their robot.
_IN_A_ROW = 3
# A robot is silent after so long and so many times its usual pause between recordings.
_SILENT, _PAUSES = timedelta(days=14), 4
# Text of failed steps, by name in the quarantine.
_CANNOT = {"drift": "drift cannot be searched", "type": "cannot be compared with its type"}
_CHANGED = {"rising": "rises", "falling": "falls", "stepped": "has stepped"}
# Start of the concern about a robot that is unlike the others.
FOREIGN = "does not belong to its type: "
# Text of an undetermined state.
UNKNOWN = "not enough data"
# Start of parameters that are torque constants by identification; the check of these.
_GAIN, _GAIN_CHECK = "gain.", "drive-gain"


class Urgency(IntEnum):
    ACT = 0
    LOOK = 1
    NONE = 2


@dataclass(frozen=True)
class Concern:
    urgency: Urgency
    text: str


def with_spreads(tables: Tables) -> Tables:
    """Tables of a fleet, `members` with the additional column `spreads`, deviations in spreads
    between robots, null if unknown. `belongs` is null if a type has too few robots."""
    spread, enough = pl.col("spread"), pl.col("robot").n_unique().over("type") >= LEAST
    types = tables["types"].select("type", "parameter", "spread")
    members = tables["members"].join(
        types, on=["type", "parameter"], how="left", maintain_order="left"
    )
    return {
        **tables,
        "members": members.with_columns(
            spreads=pl.col("deviation") / pl.when(spread > 0).then(spread),
            belongs=pl.when(enough).then(pl.col("belongs")),
        ),
    }


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot.

    Attributes:
        tables: its rows, and those of all types.
        recordings: number of recordings, quarantined and absent ones included.
        quarantined: number of quarantined ones.
        first, last: times of the first and last usable recording.
        drives: its rows of the table of drift, changed drives first.
        noise, worst_error: of its last fit.
        belongs: whether it belongs to its type; None if unknown.
        concerns: the most urgent first.
    """

    name: str
    type: str
    tables: Tables
    recordings: int = 0
    quarantined: int = 0
    first: datetime | None = None
    last: datetime | None = None
    drives: tuple[Row, ...] = ()
    noise: float | None = None
    worst_error: float | None = None
    belongs: bool | None = None
    concerns: tuple[Concern, ...] = ()

    @property
    def urgency(self) -> Urgency:
        return min((concern.urgency for concern in self.concerns), default=Urgency.NONE)

    @property
    def changed(self) -> tuple[Row, ...]:
        return tuple(drive for drive in self.drives if drive["state"] in _CHANGED)

    @property
    def is_known(self) -> bool:
        """Whether the state of all drives is determined."""
        return bool(self.drives) and all(drive["state"] != "unknown" for drive in self.drives)

    @property
    def until(self) -> datetime | None:
        """The first day that a drive reaches its limit."""
        return min((x["horizon"] for x in self.changed if x["horizon"] is not None), default=None)


def robots_of(tables: Tables) -> tuple[Robot, ...]:
    """All robots of all tables: the most urgent first, then by limits to come, then by names."""
    types = dict[str, str]()
    for name in ("members", "parameters", "recordings"):
        types |= dict(tables[name].select("robot", "type").unique().iter_rows())
    for name in ("friction", "drift", "quarantine"):
        types = dict.fromkeys(tables[name]["robot"].to_list(), "") | types
    now = tables["recordings"].filter(pl.col("reason") == "")["time"].max()
    parts = {
        key: frame.partition_by("robot", as_dict=True, maintain_order=True)
        for key, frame in tables.items()
        if key != "types"
    }
    robots = [
        _robot(
            name,
            kind,
            {"types": tables["types"]}
            | {key: part.get((name,), tables[key].clear()) for key, part in parts.items()},
            now,
        )
        for name, kind in types.items()
        if name
    ]
    return tuple(
        sorted(robots, key=lambda robot: (robot.urgency, robot.until or datetime.max, robot.name))
    )


def _robot(name: str, kind: str, tables: Tables, now: Any) -> Robot:
    parameters, belongs = tables["parameters"], tables["members"]["belongs"]
    rows = tables["recordings"].sort("time").to_dicts()
    usable = [row["time"] for row in rows if not row["reason"] and row["time"] is not None]
    last = None if parameters.is_empty() else last_period(parameters).row(-1, named=True)
    # Changed drives first, by the day on which they reach their limits.
    drives = sorted(
        tables["drift"].to_dicts(),
        key=lambda drive: (drive["state"] not in _CHANGED, drive["horizon"] or datetime.max),
    )
    quarantine = tables["quarantine"]
    period = last["period"] if last and last["period"] != ALL else ""
    concerns = [
        *(_friction(row, now) for row in drives if row["state"] in _CHANGED),
        *_gains(parameters if last is None else last_period(parameters)),
        *_doubted(rows),
        *_recorded(rows, usable, now),
        *_foreign(tables["members"].filter(~pl.col("belongs")).to_dicts()),
        *_refused(quarantine, period, recorded=bool(rows)),
    ]
    refused = {row["path"] for row in rows if row["reason"]}
    refused |= set(quarantine.filter(pl.col("what") == "recording")["which"])
    return Robot(
        name,
        kind,
        tables,
        recordings=len(refused | {row["path"] for row in rows}),
        quarantined=len(refused),
        first=usable[0] if usable else None,
        last=usable[-1] if usable else None,
        drives=tuple(drives),
        noise=last["noise"] if last else None,
        worst_error=last["worst_error"] if last else None,
        belongs=None if belongs.is_empty() or belongs.has_nulls() else bool(belongs.all()),
        concerns=tuple(sorted(concerns, key=lambda concern: concern.urgency)),
    )


def last_period(parameters: pl.DataFrame) -> pl.DataFrame:
    """A robot's parameters of its last period, or of all recordings together."""
    periods = parameters.filter(pl.col("period") != ALL)
    rows = parameters if periods.is_empty() else periods
    return rows.filter(pl.col("period") == rows["period"].max())


def _friction(row: Row, now: datetime | None) -> Concern:
    stepped = row["state"] == "stepped"
    text = f"friction of {row['drive']} {_CHANGED[row['state']]}"
    size = row["step"] if stepped else row["rate"]
    sign = "+" * (stepped and size > 0) + "−" * (stepped and size < 0)
    when = f"{'about' if stepped else 'a month since'} {day(row['change'])}"
    text += f" by {sign}{percent(abs(size))} {when}"
    if row["state"] == "falling" or row["horizon"] is None:
        return Concern(Urgency.LOOK, text)
    soonest = row["horizon_low"] or row["horizon"]
    if now is not None and row["horizon"] <= now:
        return Concern(Urgency.ACT, f"{text} and is beyond its limit")
    text += f" and reaches its limit about {day(row['horizon'])}"
    if row["horizon_low"] is not None:
        text += f", hardly before {day(row['horizon_low'])}"
    urgent = now is not None and soonest <= now + _SOON
    return Concern(Urgency.ACT if urgent else Urgency.LOOK, text)


def _gains(parameters: pl.DataFrame) -> list[Concern]:
    """Wrong torque constants: in N m, or, if only their ratios are known (their product is 1),
    against those of most drives."""
    gains = parameters.filter(pl.col("parameter").str.starts_with(_GAIN))
    logs, stds = gains["value"].log(), gains["std"] / gains["value"]
    is_ratio = len(gains) > 1 and abs(float(logs.sum())) <= NORMAL * float(stds.sum())
    usual = median(gains["value"].to_list() or [1.0]) if is_ratio else 1.0
    against = ", against other drives" if is_ratio else ""
    return [
        Concern(
            Urgency.LOOK,
            f"{row['parameter'].removeprefix(_GAIN)} gives {row['value'] / usual:.3f} ± "
            f"{row['std'] / usual:.1g} times the torque that it records{against}: torque constant, "
            "gear ratio or unit of torques?",
        )
        for row in gains.iter_rows(named=True)
        if not row["low"] <= usual <= row["high"]
    ]


def _doubted(rows: Sequence[Row]) -> list[Concern]:
    """A torque constant that checks of the last usable recordings call wrong. Fits do not correct
    it, so it may pass for a body."""
    checks = [row["verdicts"].split(", ") for row in reversed(rows) if not row["reason"]]
    count = len([*takewhile(lambda keys: _GAIN_CHECK in keys, checks)])
    which = f"last {count} recordings show" if len(checks) > 1 else "only recording shows"
    text = f"its {which} a wrong torque constant of a drive (deltaid check names it)"
    return [Concern(Urgency.LOOK, text)] if count >= min(_IN_A_ROW, len(checks)) > 0 else []


def _recorded(rows: Sequence[Row], usable: Sequence[datetime], now: Any) -> list[Concern]:
    late = len([*takewhile(lambda row: row["reason"], reversed(rows))])
    why = _short(rows[-1]["reason"]) if late else ""
    if rows and not usable:
        many = (
            f"none of its {len(rows)} recordings can" if len(rows) > 1 else "its recording cannot"
        )
        return [Concern(Urgency.ACT, f"{many} be used: {why}")]
    if late >= _IN_A_ROW:
        return [Concern(Urgency.LOOK, f"its last {late} recordings are in quarantine: {why}")]
    if usable and now is not None:
        pauses = [(after - before).total_seconds() for before, after in pairwise(usable)]
        usual = timedelta(seconds=median(pauses or [0.0]))
        if now - usable[-1] > max(_SILENT, _PAUSES * usual):
            return [Concern(Urgency.LOOK, f"no recording since {day(usable[-1])}")]
    return []


def _foreign(rows: Sequence[Row]) -> list[Concern]:
    reasons = list(dict.fromkeys(row["reason"] for row in rows if row["reason"]))
    why = "; ".join(reasons[:2]) or ", ".join(row["parameter"] for row in rows[:4])
    return [Concern(Urgency.LOOK, f"{FOREIGN}{why}")] if rows else []


def _refused(quarantine: pl.DataFrame, last: str, *, recorded: bool) -> list[Concern]:
    """Quarantined steps and absent recordings; no period before the last fit."""
    what, together = pl.col("what"), {ALL: "all of its recordings together"}
    others = quarantine.filter((what != "recording") & ((what != "fit") | (pl.col("which") > last)))
    absent = quarantine.filter(what == "recording").tail(0 if recorded else 1)
    said = [
        (Urgency.LOOK, _CANNOT.get(step, f"no fit of {together.get(which, which)}"), reason)
        for step, which, reason in others.tail(1).select("what", "which", "reason").iter_rows()
    ]
    said += [
        (Urgency.ACT, f"no recording of it is there: {which}", reason)
        for which, reason in absent.select("which", "reason").iter_rows()
    ]
    return [Concern(urgency, f"{text}: {_short(reason)}") for urgency, text, reason in said]


def _short(reason: str) -> str:
    return quoted((reason.strip().splitlines() or [""])[0])


def day(time: datetime | None) -> str:
    """An ISO date, or a dash."""
    return "—" if time is None else f"{time:%Y-%m-%d}"
