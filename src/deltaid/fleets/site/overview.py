"""The page of a whole fleet: which robots need attention and why, then all of them."""

from collections.abc import Mapping, Sequence

import polars as pl

from deltaid.fleets.site.friction_figure import friction_panel, main_quantity
from deltaid.fleets.site.parts import (
    LIKE,
    NOTHING,
    WORDS,
    Panel,
    bounds,
    grid,
    share,
    shown,
    state,
)
from deltaid.fleets.site.state import UNKNOWN, FleetTables, Robot, Urgency, day
from deltaid.fleets.site.type_page import deviations, levels, type_section
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust

# Robots that the verdict names, those in the table below it, panels of friction.
_NAMED, _LISTED, _PANELS = 3, 20, 12


def overview(
    tables: FleetTables,
    robots: Sequence[Robot],
    title: str,
    links: Mapping[str, str],
    types: Mapping[str, str],
    labels: Mapping[str, str],
) -> Page:
    """The page of a fleet.

    Args:
        title: of the page.
        links: addresses of the robots' pages.
        types: addresses of the types' pages.
        labels: what types are called.
    """
    urgent = [robot for robot in robots if robot.urgency < Urgency.NONE]
    rising = sum(row["state"] == "rising" for robot in robots for row in robot.drives)
    # What the quarantine holds, such as '2 of recording, 1 of fit'.
    refused = tables.quarantine.group_by("what", maintain_order=True).len().iter_rows()
    return Page(
        title=title,
        subtitle=_subtitle(robots, types),
        verdict=_verdict(robots, urgent),
        facts=(
            Fact("need attention", str(len(urgent)), f"of {len(robots)} robots"),
            Fact("recordings", str(sum(robot.recordings for robot in robots))),
            Fact(
                "in quarantine",
                str(len(tables.quarantine)),
                ", ".join(f"{what}: {many}" for what, many in refused),
            ),
            Fact("drives with rising friction", str(rising)),
            Fact("not like their type", str(sum(robot.belongs is False for robot in robots))),
        ),
        warnings=_of_types(tables, labels),
        front=(*_attention(urgent, links), *_rising(tables, urgent)),
        sections=(
            Section("Robots", (_robots(robots, links, labels),), "all of them", unfolded=True),
            *levels(tables, robots, labels),
            *deviations(tables, labels),
            *type_section(tables, robots, types, labels),
            *_quarantine(tables),
        ),
    )


def _verdict(robots: Sequence[Robot], urgent: Sequence[Robot]) -> Summary:
    """In one sentence how many robots need attention, then which and why."""
    act = sum(robot.urgency is Urgency.ACT for robot in urgent)
    lines = [
        f"{robot.name}: {'; '.join(concern.text for concern in robot.concerns)}."
        for robot in urgent[:_NAMED]
    ]
    if len(urgent) > _NAMED:
        lines.append(f"And {len(urgent) - _NAMED} more, listed below.")
    lines += _untold(robots)
    many = f"{len(urgent)} of {len(robots)} robots {'needs' if len(urgent) == 1 else 'need'}"
    if act:
        now = "now" if act == len(urgent) else f", {act} of them now"
        grade, said = Trust.POOR, f"{many} attention{' ' * (now == 'now')}{now}."
    elif urgent:
        grade, said = Trust.FAIR, f"{many} attention."
    elif open_ := sum(not robot.is_known for robot in robots):
        said = (
            "No robot is known to need attention, but there is not enough data on "
            f"{open_} of {len(robots)}."
        )
        grade = Trust.UNTESTED
    else:
        grade, said = Trust.GOOD, f"None of {len(robots)} robots needs attention."
    return Summary(grade, said, tuple(lines))


def _untold(robots: Sequence[Robot]) -> list[str]:
    """What nobody can tell yet, and what was not used."""
    drives = [row for robot in robots for row in robot.drives]
    unknown = sum(row["state"] == "unknown" for row in drives)
    lines = list[str]()
    if unknown:
        lines.append(
            f"Not enough data on {unknown} of {len(drives)} drives to say whether their friction "
            "changes."
        )
    bad = sum(robot.quarantined for robot in robots)
    if bad:
        all_of_them = sum(robot.recordings for robot in robots)
        lines.append(f"{bad} of {all_of_them} recordings are in quarantine and were not used.")
    return lines + [f"False alarms of changes: {text}." for text in bounds(drives)[:1]]


def _of_types(tables: FleetTables, labels: Mapping[str, str]) -> tuple[str, ...]:
    """Types of which nothing could be said, and why."""
    lost = tables.quarantine.filter((pl.col("what") == "type") & (pl.col("robot") == ""))
    return tuple(
        f"Robots of type {labels.get(row['which'], row['which'])} could not be compared: "
        f"{row['reason']}"
        for row in lost.iter_rows(named=True)
    )


def _subtitle(robots: Sequence[Robot], types: Mapping[str, str]) -> str:
    firsts = [robot.first for robot in robots if robot.first is not None]
    lasts = [robot.last for robot in robots if robot.last is not None]
    span = f", {day(min(firsts))} to {day(max(lasts))}" if firsts else ""
    count = len(types)
    return f"{len(robots)} robots of {count} type{'s' if count != 1 else ''}{span}"


def _attention(urgent: Sequence[Robot], links: Mapping[str, str]) -> tuple[Block, ...]:
    """Why each robot needs attention, the most urgent first."""
    if not urgent:
        return ()
    listed = urgent[:_LISTED]
    rows = tuple(
        (robot.name, WORDS[robot.urgency], "; ".join(concern.text for concern in robot.concerns))
        for robot in listed
    )
    more = len(urgent) - len(listed)
    return (
        Table(
            ("robot", "how soon", "why"),
            rows,
            "Robots that need attention: act within four weeks, or look when there is time."
            + f" {more} more are the next in the table of all robots." * (more > 0),
            marked=frozenset(range(len(rows))),
            links=tuple(links[robot.name] for robot in listed),
        ),
    )


def _rising(tables: FleetTables, urgent: Sequence[Robot]) -> tuple[Block, ...]:
    """Friction over time of drives where it changes."""
    changed = [(robot, row) for robot in urgent for row in robot.changed]
    panels = list[Panel]()
    for robot, row in changed[:_PANELS]:
        whose = (pl.col("robot") == robot.name) & (pl.col("drive") == row["drive"])
        seen = main_quantity(tables.friction.filter(whose))
        if len(seen):
            panels.append(friction_panel(f"{robot.name}, {row['drive']}", seen, row))
    if not panels:
        return ()
    more = len(changed) - len(panels)
    note = f" {more} more drives are on the pages of their robots." if more else ""
    return (
        Chart(
            grid(panels, min(3, len(panels)), x={"type": "date", "matches": "x"}, legend=True),
            "Friction over time of drives where it changes. Dotted: the day of the change, with "
            f"the days it may have been.{note}",
        ),
    )


def _robots(robots: Sequence[Robot], links: Mapping[str, str], labels: Mapping[str, str]) -> Table:
    rows = tuple(
        (
            robot.name,
            state(robot),
            labels[robot.type],
            _changed(robot),
            day(robot.until),
            LIKE[robot.belongs],
            day(robot.last),
            str(robot.recordings),
            str(robot.quarantined),
            shown(robot.noise, 3),
            share(robot.worst_error),
        )
        for robot in robots
    )
    columns = ("robot", "state", "type", "friction", "limit on", "like its type",
               "last recording", "recordings", "in quarantine", "noise",
               "torque error")  # fmt: skip
    return Table(
        columns,
        rows,
        "Noise and torque error, the worst drive's, are those of the last fit. A click on a head "
        "sorts.",
        marked=frozenset(k for k, robot in enumerate(robots) if robot.urgency < Urgency.NONE),
        links=tuple(links[robot.name] for robot in robots),
        choices=(1, 2, 5),
    )


def _changed(robot: Robot) -> str:
    """Drives whose friction changes, or what is said of all."""
    if robot.changed:
        kinds: dict[str, list[str]] = {}
        for row in robot.changed:
            kinds.setdefault(row["state"], []).append(row["drive"])
        return "; ".join(f"{state} in {' and '.join(names)}" for state, names in kinds.items())
    states = {row["state"] for row in robot.drives}
    if not states:
        return NOTHING
    return UNKNOWN if "unknown" in states else "steady"


def _quarantine(tables: FleetTables) -> tuple[Section, ...]:
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
