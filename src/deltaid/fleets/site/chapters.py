"""Chapters of a fleet's page: how friction and parameters spread, types, quarantine."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import polars as pl

from deltaid.fleets.site.parts import Panel, deviation_figure, dots, grid, most_spread
from deltaid.fleets.site.state import FleetTables, Robot
from deltaid.view.page import Chart, Section, Table, Text

# Types that have figures on the fleet's page; all have pages.
_TYPES = 6


def levels(
    tables: FleetTables, robots: Sequence[Robot], labels: Mapping[str, str]
) -> tuple[Section, ...]:
    """How friction spreads over robots of a type, drive by drive."""
    kinds = [
        kind for kind in labels if any(robot.type == kind and robot.drives for robot in robots)
    ]
    panels = [
        level_panel(
            [robot for robot in robots if robot.type == kind], labels[kind], unit_of(tables)
        )
        for kind in kinds[:_TYPES]
    ]
    panels = [panel for panel in panels if panel.traces[0]["x"]]
    if not panels:
        return ()
    figure = grid(panels, columns=min(len(panels), 3), row=300)
    blocks = (Chart(figure, "Friction of every drive of every robot; a dot is a robot."),)
    return (Section("Friction of the fleet", blocks, "level of every drive, by type"),)


def level_panel(robots: Iterable[Robot], title: str, unit: str) -> Panel:
    """Friction of all drives of some robots."""
    known = [
        (robot.name, row) for robot in robots for row in robot.drives if row["level"] is not None
    ]
    rows = pl.DataFrame(
        [(name, row["level"]) for name, row in known],
        schema={"robot": pl.String, "y": pl.Float64},
        orient="row",
    )
    trace = dots(rows, "y", "robot") | {
        "x": [row["drive"] for _, row in known],
        "hovertemplate": "%{text}: %{y:.3g}<extra></extra>",
    }
    return Panel(title, (trace,), unit=f"friction [{unit}]")


def unit_of(tables: FleetTables) -> str:
    """Of friction, where all drives have the same."""
    units = tables.drift["unit"].unique().to_list()
    return units[0] if len(units) == 1 else "unit of the drive"


def deviations(tables: FleetTables, labels: Mapping[str, str]) -> tuple[Section, ...]:
    """How robots of a type differ, parameter by parameter."""
    blocks = []
    for kind, label in labels.items():
        own = tables.members.filter(pl.col("type") == kind)
        names = most_spread(own)
        if names and len(blocks) < _TYPES:
            figure = deviation_figure(own, names)
            blocks.append(Chart(figure, f"{label}: how its robots differ; a dot is a robot."))
    if not blocks:
        return ()
    return (Section("Parameters by type", tuple(blocks), "how robots of one type differ"),)


def type_section(
    tables: FleetTables,
    robots: Sequence[Robot],
    types: Mapping[str, str],
    labels: Mapping[str, str],
) -> tuple[Section, ...]:
    count = Counter(robot.type for robot in robots)
    foreign = Counter(robot.type for robot in robots if robot.belongs is False)
    rows = tuple(
        (
            labels[kind],
            str(count[kind]),
            str(foreign[kind]),
            str(tables.types.filter(pl.col("type") == kind).height),
        )
        for kind in types
    )
    columns = ("type", "robots", "do not belong", "parameters with a type's mean")
    table = Table(columns, rows, links=tuple(types.values()))
    return (Section("Types", (table,), "what the fleet knows of each"),)


def quarantine(tables: FleetTables) -> tuple[Section, ...]:
    """Reasons of what could not be used, the most frequent first."""
    bad, reasons = tables.quarantine, dict[str, list[str]]()
    if bad.is_empty():
        return ()
    for row in bad.iter_rows(named=True):
        said = _without_name(row["reason"], row["which"])
        reasons.setdefault(said, []).append(row["robot"])
    ordered = sorted(reasons.items(), key=lambda item: -len(item[1]))
    rows = tuple(
        (str(len(whose)), ", ".join(_few(list(dict.fromkeys(whose)))), said)
        for said, whose in ordered[:50]
    )
    text = "The pages of robots have the recordings one by one, each with its reason."
    table = Table(("how many", "of robots", "reason"), rows)
    return (Section("Quarantine", (Text(text), table), f"{len(bad)} that could not be used"),)


def _few(names: Sequence[str]) -> list[str]:
    return [*names[:5], f"and {len(names) - 5} more"] if len(names) > 5 else list(names)


def _without_name(reason: str, which: str) -> str:
    """A reason without the recording's name, so that those of one cause are alike."""
    for name in (which, which.replace("\\", "/").rpartition("/")[2]):
        reason = reason.replace(name, "…") if name else reason
    return reason.removeprefix("…: ")
