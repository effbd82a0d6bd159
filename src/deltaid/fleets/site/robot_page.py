"""The page of one robot: friction of its drives, parameters by period, its type, recordings."""

import polars as pl

from deltaid.errors import counted
from deltaid.fleets.fleet import ALL
from deltaid.fleets.site.friction_panel import MAIN, friction_panel, time_axis
from deltaid.fleets.site.parts import (
    LIKE,
    MOST,
    Panel,
    bounds,
    cell,
    dates,
    drive_tables,
    ended,
    grid,
    known,
    numbers,
)
from deltaid.fleets.site.state import Robot, Urgency, day, last_period
from deltaid.view import style
from deltaid.view.model_tables import MEASURED
from deltaid.view.numbers import number, percent, span
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust

# Largest number of recordings on a page, quarantined ones first.
_RECORDINGS = 500


def robot_page(robot: Robot, label: str) -> Page:
    """The page of a robot; `label` is the name of its type."""
    tables = robot.tables
    charts = [*_friction(robot), *_temperature(tables["friction"])]
    said = " ".join(f"False alarms: {text}." for text in bounds(robot.drives))
    failed = tables["quarantine"].filter(pl.col("what") != "recording")
    lost = Table(
        ("what", "of", "reason"), tuple(failed.select("what", "which", "reason").iter_rows())
    )
    sections = (
        Section("Drives", drive_tables(robot.drives, said) if robot.drives else (),
                "changes of friction, rates, limits", unfolded=True),
        Section("What friction goes with", tuple(charts[1:]),
                "what else was detected, and temperature"),
        _parameters(tables["parameters"]),
        _beside_type(robot, tables["members"]),
        _recordings(tables["recordings"]),
        Section("What could not be fitted", (lost,) if lost.rows else (), f"{len(failed)} in all"),
    )  # fmt: skip
    shown = tuple(section for section in sections if section.blocks)
    used = f"used from {day(robot.first)} to {day(robot.last)}" if robot.first else "none used"
    return Page(
        title=robot.name,
        subtitle=f"{label}, {counted(robot.recordings, 'recording')}, {used}",
        verdict=_verdict(robot),
        facts=(
            Fact("last recording", day(robot.last)),
            Fact("recordings", str(robot.recordings), f"{robot.quarantined} in quarantine"),
            Fact("torque error", cell(percent, robot.worst_error), "worst drive, last fit"),
            Fact("noise", cell(number, robot.noise, 3), "last fit"),
            Fact("like its type", LIKE[robot.belongs]),
        ),
        front=tuple(charts[:1]),
        sections=shown or (Section("Nothing", (Text("No table has this robot."),)),),
    )


def _verdict(robot: Robot) -> Summary:
    lines = tuple(
        ended(f"{concern.text[0].upper()}{concern.text[1:]}") for concern in robot.concerns
    )
    if robot.urgency is Urgency.ACT:
        return Summary(Trust.POOR, "Act now.", lines)
    if robot.urgency is Urgency.LOOK:
        return Summary(Trust.FAIR, "Inspect it when there is time.", lines)
    if robot.is_known:
        return Summary(Trust.GOOD, "No inspection needed.", ("All friction is steady.",))
    unknown = (row for row in robot.drives if row["state"] == "unknown")
    said = "Not enough data to say whether friction changes."
    lines = tuple(f"{row['drive']}: {row['reason']}." for row in unknown)
    return Summary(Trust.UNTESTED, said, lines)


def _friction(robot: Robot) -> list[Chart]:
    """Friction of every drive over time, then its other quantities."""
    friction, charts = robot.tables["friction"].sort("time"), list[Chart]()
    drift = {row["drive"]: row for row in robot.drives}
    drives = list(dict.fromkeys([*drift, *robot.tables["friction"]["drive"].to_list()]))
    for quantity in sorted({*friction["quantity"]}, key=lambda name: (name != MAIN, name)):
        caption = f"{quantity[:1].upper()}{quantity[1:]} of each drive over time."
        if quantity == MAIN:
            caption += " Dotted: the day of a change, with the days it may have been."
        panels = [
            friction_panel(drive, part, drift.get(drive) if quantity == MAIN else None)
            for drive in drives
            if len(part := friction.filter(quantity=quantity, drive=drive))
        ]
        charts.append(Chart(grid(panels, x=time_axis(friction), legend=True), caption))
    return charts


def _temperature(friction: pl.DataFrame) -> tuple[Chart, ...]:
    rows = friction.filter(pl.col("temperature").is_not_null()).unique("time").sort("time")
    if rows.is_empty():
        return ()
    figure = {
        "data": [
            {
                "type": "scatter",
                "x": dates(rows["time"]),
                "y": numbers(rows["temperature"]),
                "mode": "lines+markers",
                "marker": {"color": style.SERIES[4], "size": 4},
                "line": {"color": style.SERIES[4], "width": 1},
            }
        ],
        "layout": {"height": 240, "yaxis": {"title": {"text": "temperature [°C]"}}},
    }
    return (Chart(figure, "Temperature of each recording."),)


def _recordings(recordings: pl.DataFrame) -> Section:
    ordered = recordings.with_columns(bad=pl.col("reason") != "").sort(
        ["bad", "time"], descending=[True, True]
    )
    kept, bad = ordered.head(_RECORDINGS), int(ordered["bad"].sum())
    places = [path.replace("\\", "/").rpartition("/") for path in kept["path"]]
    folders = list(dict.fromkeys(folder for folder, _, _ in places))
    rows = tuple(
        (
            cell("{:%Y-%m-%d %H:%M}".format, row["time"]),
            "quarantine" if row["bad"] else "used",
            name,
            cell(number, row["load"]),
            cell(number, row["temperature"]),
            cell(str, row["samples"]),
            row["reason"] or row["verdicts"] or "",
        )
        for row, (_, _, name) in zip(kept.iter_rows(named=True), places, strict=True)
    )
    left = len(ordered) - len(kept)
    said = f"{left} older ones are in recordings.parquet. " * (left > 0)
    said += f"They lie in {', '.join(folders[:3])}" + ", and others." * (len(folders) > 3)
    table = Table(
        ("time", "state", "file", "load [kg]", "temperature [°C]", "samples", "not good"),
        rows,
        said,
        marked=frozenset(range(min(bad, len(kept)))),
        choices=(1,),
    )
    return Section(
        "Recordings", (table,) if rows else (), f"{len(ordered)}, {bad} of them in quarantine"
    )


def _parameters(parameters: pl.DataFrame) -> Section:
    fitted = parameters.filter(pl.col("decided_by") != "structure")
    if fitted.is_empty():
        return Section("Parameters", ())
    whole, single = (fitted.filter((pl.col("period") == ALL) == is_) for is_ in (True, False))
    ordered = (single if len(single) else whole).sort("period", maintain_order=True)
    last = last_period(fitted)
    blocks: list[Block] = [*_over_periods(ordered)]
    if len(whole) and whole["recordings"][0] != last["recordings"][0]:
        blocks.append(_values(whole, ordered, "Fitted to all recordings together."))
    blocks.append(_values(last, ordered, f"Fitted to the recordings of {last['period'][0]}."))
    poor = dict(ordered.select("period", "verdicts").unique(maintain_order=True).iter_rows())
    if doubts := tuple((period, keys) for period, keys in poor.items() if keys):
        blocks.append(Table(("period", "checks that are not good"), doubts))
    many = "by period, one" if len(poor) == 1 else f"by period, {len(poor)} of them"
    return Section("Parameters", tuple(blocks), f"{many}; what decided each")


def _values(fit: pl.DataFrame, ordered: pl.DataFrame, said: str) -> Table:
    by_data = pl.col("decided_by").is_in(MEASURED)
    periods = ordered.group_by("parameter").agg(by_data.sum(), pl.len()).rows_by_key("parameter")
    rows = tuple(
        (
            row["parameter"],
            *known(row["value"], row["std"]),
            row["unit"],
            cell(span, row["low"], row["high"]),
            cell(number, row["prior"]),
            row["decided_by"],
            f"{decided} of {many}",
        )
        for row in fit.iter_rows(named=True)
        for decided, many in periods.get(row["parameter"], [(0, 0)])
    )
    grey = frozenset(k for k, by in enumerate(fit["decided_by"]) if by not in MEASURED)
    return Table(
        ("parameter", "value", "±", "unit", "95 % interval", "prior", "decided by",
         "periods by data"),
        rows,
        f"{said} Grey: taken from the prior, not identifiable.",
        muted=grey,
    )  # fmt: skip


def _over_periods(ordered: pl.DataFrame) -> tuple[Chart, ...]:
    decided = ordered.filter(pl.col("decided_by").is_in(MEASURED))
    names = list(dict.fromkeys(decided["parameter"].to_list()))
    if not names or ordered["period"].n_unique() < 2:
        return ()
    panels = [_panel(ordered.filter(parameter=name)) for name in names[:MOST]]
    return (
        Chart(
            grid(panels, columns=3, row=130, x={"type": "category", "nticks": 4}),
            "Parameters that data shows, by period, with 95 % intervals; open where the prior "
            "decided." + f" {len(names) - MOST} more are in the table." * (len(names) > MOST),
        ),
    )


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
            "symbol": ["circle" if by in MEASURED else "circle-open" for by in decided],
        },
    }
    unit = rows["unit"][0]
    return Panel(f"{rows['parameter'][0]} [{unit}]" if unit else rows["parameter"][0], (trace,))


def _beside_type(robot: Robot, members: pl.DataFrame) -> Section:
    ordered = members.with_columns(size=pl.col("spreads").abs()).sort(
        "size", descending=True, nulls_last=True
    )
    rows = tuple(
        (
            row["parameter"],
            cell(number, row["deviation"], 3),
            row["unit"],
            cell(number, row["spreads"], 2),
            *known(row["value"], row["std"]),
            cell(span, row["low"], row["high"]),
            cell(number, row["alone_std"], 2),
        )
        for row in ordered.iter_rows(named=True)
    )
    columns = ("parameter", "deviation", "unit", "in spreads", "value", "±", "95 % interval",
               "± alone")  # fmt: skip
    foreign = robot.belongs is False
    values = "Values by its own recordings" if foreign else "Values with what the type adds"
    caption = (
        f"Deviation from the mean of its type. {values}, "
        "± alone is by its own recordings. A spread is the standard deviation between robots."
    )
    blocks: list[Block] = [Table(columns, rows, caption)] if rows else []
    if reasons := dict.fromkeys(filter(None, members["reason"].to_list())):
        said = "It does not belong to its type" if foreign else "It belongs to its type, but"
        blocks.insert(0, Text(ended(f"{said}: {'; '.join(reasons)}")))
    return Section(
        "Beside its type",
        tuple(blocks),
        "how far it is from others of its type",
        unfolded=foreign,
    )
