"""The page of one robot: friction of its drives, parameters by period, its type, recordings."""

import polars as pl

from deltaid.fleets.site.friction_figure import MAIN, friction_panel, time_axis
from deltaid.fleets.site.parts import (
    LIKE,
    MOST,
    Panel,
    between,
    bounds,
    count,
    dates,
    drive_tables,
    grid,
    known,
    numbers,
    share,
    shown,
)
from deltaid.fleets.site.state import ALL, Robot, Row, Urgency, day, last_period
from deltaid.view import style
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust

_GRADES = {Urgency.ACT: Trust.POOR, Urgency.LOOK: Trust.FAIR, Urgency.NONE: Trust.GOOD}
# Rows of recordings that a page has at most; those in quarantine come first.
_RECORDINGS = 500
# What says that a value is seen and not taken from elsewhere.
SEEN = ("data", "sum", "measured", "sensors")


def robot_page(robot: Robot, label: str) -> Page:
    """The page of a robot; `label` is what its type is called."""
    tables = robot.tables
    friction, temperature = _friction(robot, tables.friction)
    return Page(
        title=robot.name,
        subtitle=f"{label}, {robot.recordings} recording{'s' * (robot.recordings != 1)}, "
        f"{day(robot.first)} to {day(robot.last)}",
        verdict=_verdict(robot),
        facts=(
            Fact("last recording", day(robot.last)),
            Fact("recordings", str(robot.recordings), f"{robot.quarantined} in quarantine"),
            Fact("torque error", share(robot.worst_error), "worst drive, last fit"),
            Fact("noise", shown(robot.noise, 3), "last fit"),
            Fact("like its type", LIKE[robot.belongs]),
        ),
        front=friction,
        sections=(
            *_drives(robot),
            *temperature,
            *_parameters(tables.parameters),
            *_beside_type(robot, tables.members),
            *_recordings(tables.recordings),
            *_failed(tables.quarantine),
        )
        or (Section("Nothing", (Text("No table has this robot."),)),),
    )


def _verdict(robot: Robot) -> Summary:
    lines = [f"{concern.text[0].upper()}{concern.text[1:]}." for concern in robot.concerns]
    if robot.concerns:
        said = "Act now." if robot.urgency is Urgency.ACT else "Inspect it when there is time."
        return Summary(_GRADES[robot.urgency], said, tuple(lines))
    if not robot.is_known:
        reasons = (f"{row['drive']}: {row['reason']}." for row in robot.drives
                   if row["state"] == "unknown")  # fmt: skip
        said = "Not enough data to say whether friction changes."
        return Summary(Trust.UNTESTED, said, tuple(reasons))
    return Summary(Trust.GOOD, "No inspection needed.", ("All friction is steady.",))


def _friction(
    robot: Robot, friction: pl.DataFrame
) -> tuple[tuple[Block, ...], tuple[Section, ...]]:
    """Friction of every drive; what else was seen of it, and temperature, in a chapter."""
    if friction.is_empty():
        return (), ()
    drift = {row["drive"]: row for row in robot.drives}
    drives = list(dict.fromkeys([*drift, *friction["drive"].to_list()]))
    charts = list[Chart]()
    names = sorted(set(friction["quantity"].to_list()), key=lambda name: (name != MAIN, name))
    for quantity in names:
        main = quantity == MAIN
        rows = friction.filter(pl.col("quantity") == quantity).sort("time")
        parts = [(drive, rows.filter(pl.col("drive") == drive)) for drive in drives]
        panels = [
            friction_panel(drive, part, drift.get(drive) if main else None)
            for drive, part in parts
            if len(part)
        ]
        caption = f"{quantity[:1].upper()}{quantity[1:]} of each drive over time."
        if main:
            caption += " Dotted: the day of a change, with the days it may have been."
        charts.append(Chart(grid(panels, x=time_axis(friction), legend=True), caption))
    further: tuple[Block, ...] = (*charts[1:], *_temperature(friction))
    section = Section("What friction goes with", further, "what else was detected, and temperature")
    return (charts[0],), (section,) if further else ()


def _temperature(friction: pl.DataFrame) -> tuple[Chart, ...]:
    rows = friction.filter(pl.col("temperature").is_not_null()).unique("time").sort("time")
    if rows.is_empty():
        return ()
    trace = {
        "type": "scatter",
        "x": dates(rows["time"]),
        "y": numbers(rows["temperature"]),
        "mode": "lines+markers",
        "marker": {"color": style.SERIES[4], "size": 4},
        "line": {"color": style.SERIES[4], "width": 1},
    }
    layout = {"height": 240, "yaxis": {"title": {"text": "temperature [°C]"}}}
    return (Chart({"data": [trace], "layout": layout}, "Temperature of each recording."),)


def _drives(robot: Robot) -> tuple[Section, ...]:
    if not robot.drives:
        return ()
    said = " ".join(f"False alarms: {text}." for text in bounds(robot.drives))
    tables = drive_tables(robot.drives, said)
    return (Section("Drives", tables, "changes of friction, rates, limits", unfolded=True),)


def _recordings(recordings: pl.DataFrame) -> tuple[Section, ...]:
    """All recordings, those in quarantine first, then the newest."""
    if recordings.is_empty():
        return ()
    ordered = recordings.with_columns(bad=pl.col("reason") != "").sort(
        ["bad", "time"], descending=[True, True]
    )
    kept = ordered.head(_RECORDINGS)
    rows = tuple(
        (
            "—" if row["time"] is None else f"{row['time']:%Y-%m-%d %H:%M}",
            "quarantine" if row["bad"] else "used",
            row["path"].replace("\\", "/").rpartition("/")[2],
            shown(row["load"]),
            shown(row["temperature"]),
            count(row["samples"]),
            row["reason"] or row["verdicts"] or "",
        )
        for row in kept.iter_rows(named=True)
    )
    bad = int(ordered["bad"].sum())
    left = len(ordered) - len(kept)
    folders = dict.fromkeys(
        path.replace("\\", "/").rpartition("/")[0] for path in kept["path"].to_list()
    )
    said = f"{left} older ones are in recordings.parquet. " * (left > 0)
    said += f"They lie in {', '.join(list(folders)[:3])}" + ", and others." * (len(folders) > 3)
    table = Table(
        ("time", "state", "file", "load [kg]", "temperature [°C]", "samples", "not good"),
        rows,
        said,
        marked=frozenset(range(min(bad, len(kept)))),
        choices=(1,),
    )
    return (Section("Recordings", (table,), f"{len(ordered)}, {bad} of them in quarantine"),)


def _failed(quarantine: pl.DataFrame) -> tuple[Section, ...]:
    fits = quarantine.filter(pl.col("what") != "recording")
    if fits.is_empty():
        return ()
    rows = tuple(fits.select("what", "which", "reason").iter_rows())
    table = Table(("what", "of", "reason"), rows)
    return (Section("What could not be fitted", (table,), f"{len(fits)} in all"),)


def _parameters(parameters: pl.DataFrame) -> tuple[Section, ...]:
    """Parameters over the periods, and all of the last one and of all recordings together."""
    fitted = parameters.filter(pl.col("decided_by") != "structure")  # nothing to be told of
    if fitted.is_empty():
        return ()
    whole, single = (fitted.filter((pl.col("period") == ALL) == is_) for is_ in (True, False))
    ordered = (single if len(single) else whole).sort("period", maintain_order=True)
    last = last_period(fitted)
    tables = [_values(last, ordered, f"Fitted to the recordings of {last['period'][0]}.")]
    if len(whole) and whole["recordings"][0] != last["recordings"][0]:
        tables.insert(0, _values(whole, ordered, "Fitted to all recordings together."))
    poor = dict(ordered.select("period", "verdicts").unique(maintain_order=True).iter_rows())
    doubts = tuple((period, keys) for period, keys in poor.items() if keys)
    blocks: list[Block] = [*_over_periods(ordered), *tables]
    if doubts:
        blocks.append(Table(("period", "checks that are not good"), doubts))
    many = "by period, one" if len(poor) == 1 else f"by period, {len(poor)} of them"
    return (Section("Parameters", tuple(blocks), f"{many}; what decided each"),)


def _values(fit: pl.DataFrame, ordered: pl.DataFrame, said: str) -> Table:
    rows = tuple(_parameter(row, ordered) for row in fit.iter_rows(named=True))
    columns = ("parameter", "value", "±", "unit", "95 % interval", "prior", "decided by",
               "periods by data")  # fmt: skip
    seen = fit["decided_by"].is_in(SEEN).to_list()
    grey = frozenset(k for k, is_seen in enumerate(seen) if not is_seen)
    return Table(columns, rows, f"{said} Grey: taken from the prior, not identifiable.", muted=grey)


def _parameter(row: Row, ordered: pl.DataFrame) -> tuple[str, ...]:
    said, width = known(row["value"], row["std"])
    own = ordered.filter(pl.col("parameter") == row["parameter"])
    seen = own.filter(pl.col("decided_by").is_in(SEEN)).height
    return (
        str(row["parameter"]),
        said,
        width,
        str(row["unit"]),
        between(row["low"], row["high"]),
        shown(row["prior"]),
        str(row["decided_by"]),
        f"{seen} of {len(own)}",
    )


def _over_periods(ordered: pl.DataFrame) -> tuple[Chart, ...]:
    """Those that data shows, over the periods; open where the prior decided."""
    seen = ordered.filter(pl.col("decided_by").is_in(SEEN))
    names = list(dict.fromkeys(seen["parameter"].to_list()))
    if not names or ordered["period"].n_unique() < 2:
        return ()
    panels = [_panel(ordered.filter(pl.col("parameter") == name)) for name in names[:MOST]]
    left = len(names) - len(panels)
    said = (
        "Parameters that data shows, by period, with 95 % intervals; open where the prior decided."
        + f" {left} more are in the table." * (left > 0)
    )
    figure = grid(panels, columns=3, row=130, x={"type": "category", "nticks": 4})
    return (Chart(figure, said),)


def _panel(rows: pl.DataFrame) -> Panel:
    value, decided = rows["value"], rows["decided_by"].to_list()
    trace = {
        "type": "scatter",
        "x": rows["period"].to_list(),
        "y": numbers(value),
        "error_y": {
            "type": "data",
            "array": numbers((rows["high"] - value).fill_null(0.0)),
            "arrayminus": numbers((value - rows["low"]).fill_null(0.0)),
            "width": 0,
            "thickness": 1,
        },
        "text": [style.label(by) for by in decided],
        "hovertemplate": "%{x}: %{y:.4g}, %{text}<extra></extra>",
        "mode": "markers",
        "marker": {
            "color": style.IDENTIFIED,
            "size": 5,
            "symbol": ["circle" if by in SEEN else "circle-open" for by in decided],
        },
    }
    unit = rows["unit"][0]
    return Panel(f"{rows['parameter'][0]} [{unit}]" if unit else rows["parameter"][0], (trace,))


def _beside_type(robot: Robot, members: pl.DataFrame) -> tuple[Section, ...]:
    if members.is_empty():
        return ()
    ordered = members.with_columns(size=pl.col("spreads").abs()).sort(
        "size", descending=True, nulls_last=True
    )
    rows = tuple(
        (
            row["parameter"],
            shown(row["deviation"], 3),
            row["unit"],
            shown(row["spreads"], 2),
            *known(row["value"], row["std"]),
            between(row["low"], row["high"]),
            shown(row["alone_std"], 2),
        )
        for row in ordered.iter_rows(named=True)
    )
    columns = ("parameter", "deviation", "unit", "in spreads", "value", "±", "95 % interval",
               "± alone")  # fmt: skip
    foreign = robot.belongs is False
    table = Table(
        columns,
        rows,
        "Deviation from the mean of its type. "
        + ("Values by its own recordings, " if foreign else "Values with what the type adds, ")
        + "± alone is by its own recordings. A spread is the standard deviation between robots.",
    )
    reasons = dict.fromkeys(reason for reason in members["reason"].to_list() if reason)
    said = "It does not belong to its type: " if foreign else "It belongs to its type, but: "
    words = (Text(f"{said}{'; '.join(reasons)}."),) if reasons else ()
    return (
        Section("Beside its type", (*words, table), "how far it is from others of its type",
                unfolded=foreign),
    )  # fmt: skip
