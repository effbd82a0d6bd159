"""The page of one robot: friction of its drives, parameters by period, its type, recordings."""

from collections.abc import Mapping

import polars as pl

from deltaid.fleets.site.friction_figure import MAIN, friction_panel, time_axis
from deltaid.fleets.site.parameter_sections import parameter_section, type_section
from deltaid.fleets.site.parts import (
    NOTHING,
    bounds,
    count,
    dates,
    drive_tables,
    grid,
    numbers,
    share,
    shown,
)
from deltaid.fleets.site.state import Robot, Urgency, day
from deltaid.view import style
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust

_GRADES = {Urgency.ACT: Trust.POOR, Urgency.LOOK: Trust.FAIR, Urgency.NONE: Trust.GOOD}
# Rows of recordings that a page has at most; those in quarantine come first.
_RECORDINGS = 500


def robot_page(robot: Robot, label: str, parts: Mapping[str, pl.DataFrame]) -> Page:
    """The page of a robot.

    Args:
        label: what its type is called.
        parts: its rows of each table.
    """
    friction, temperature = _friction(robot, parts["friction"])
    return Page(
        title=robot.name,
        subtitle=f"{label or 'of no type'}, {robot.recordings} recordings, "
        f"{day(robot.first)} to {day(robot.last)}",
        verdict=_verdict(robot),
        facts=_facts(robot),
        front=friction,
        sections=(
            *_drives(robot),
            *temperature,
            *parameter_section(parts["parameters"]),
            *type_section(robot, parts["members"]),
            *_recordings(parts["recordings"]),
            *_failed(parts["quarantine"]),
        )
        or (Section("Nothing", (Text("No table has this robot."),)),),
    )


def _verdict(robot: Robot) -> Summary:
    lines = [f"{concern.text[0].upper()}{concern.text[1:]}." for concern in robot.concerns]
    if robot.concerns:
        said = "Act now." if robot.urgency is Urgency.ACT else "Inspect it when there is time."
        return Summary(_GRADES[robot.urgency], said, tuple(lines))
    states = {row["state"] for row in robot.drives}
    if states != {"steady"}:
        lines.append("Not enough data to say whether friction changes.")
        return Summary(Trust.UNTESTED, "No inspection needed.", tuple(lines))
    return Summary(Trust.GOOD, "No inspection needed.", ("All friction is steady.",))


def _facts(robot: Robot) -> tuple[Fact, ...]:
    like = {True: "yes", False: "no", None: NOTHING}[robot.belongs]
    return (
        Fact("last recording", day(robot.last)),
        Fact("recordings", str(robot.recordings), f"{robot.quarantined} in quarantine"),
        Fact("torque error", share(robot.worst_error), "worst drive, last fit"),
        Fact("noise", shown(robot.noise, 3), "last fit"),
        Fact("like its type", like),
    )


def _friction(
    robot: Robot, friction: pl.DataFrame
) -> tuple[tuple[Block, ...], tuple[Section, ...]]:
    """Friction of every drive; what else was seen of it, and temperature, in a chapter."""
    if friction.is_empty():
        return (), ()
    drift = {row["drive"]: row for row in robot.drives}
    drives = list(dict.fromkeys(friction["drive"].to_list()))
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
    section = Section("What friction goes with", further, "what else was seen, and temperature")
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
    """Periods that could not be fitted."""
    fits = quarantine.filter(pl.col("what") != "recording")
    if fits.is_empty():
        return ()
    rows = tuple(fits.select("what", "which", "reason").iter_rows())
    table = Table(("what", "of", "reason"), rows)
    return (Section("What could not be fitted", (table,), f"{len(fits)} in all"),)
