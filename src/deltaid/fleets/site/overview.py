"""The first page of a site: robots that need attention with reasons, then all robots."""

from collections.abc import Mapping, Sequence

import polars as pl

from deltaid.errors import counted, few
from deltaid.fleets.site.friction_panel import MAIN, friction_panel
from deltaid.fleets.site.parts import LIKE, MOST, NOTHING, WORDS, bounds, cell, ended, grid
from deltaid.fleets.site.state import UNKNOWN, Robot, Tables, Urgency, day
from deltaid.fleets.site.type_page import deviations, foreign_count, levels, type_section
from deltaid.grouping import grouped
from deltaid.view.numbers import FEW, number, percent
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust


def overview(
    tables: Tables,
    robots: Sequence[Robot],
    title: str,
    links: Mapping[str, str],
    types: Mapping[str, str],
    labels: Mapping[str, str],
) -> Page:
    """The page of a fleet.

    Args:
        links: addresses of the robots' pages.
        types: addresses of the types' pages.
        labels: names of types.
    """
    urgent = [robot for robot in robots if robot.urgency < Urgency.NONE]
    rising = sum(row["state"] == "rising" for robot in robots for row in robot.drives)
    bad = tables["quarantine"]
    # Contents of the quarantine, such as 'recording: 2, fit: 1'.
    refused = bad.group_by("what", maintain_order=True).len().iter_rows()
    times = [time for robot in robots for time in (robot.first, robot.last) if time is not None]
    span = f", {day(min(times))} to {day(max(times))}" if times else ""
    # Types whose fits failed.
    lost = bad.filter((pl.col("what") == "type") & (pl.col("robot") == ""))
    return Page(
        title=title,
        subtitle=f"{counted(len(robots), 'robot')} of {counted(len(types), 'type')}{span}",
        verdict=_verdict(robots, urgent),
        facts=(
            Fact("need attention", str(len(urgent)), f"of {len(robots)} robots"),
            Fact("recordings", str(sum(robot.recordings for robot in robots))),
            Fact(
                "in quarantine",
                str(len(bad)),
                ", ".join(f"{what}: {many}" for what, many in refused),
            ),
            Fact("drives with rising friction", str(rising)),
            Fact("not like their type", foreign_count(robots)),
        ),
        warnings=tuple(
            f"Robots of type {labels.get(which, which)} could not be compared: {reason}"
            for which, reason in lost.select("which", "reason").iter_rows()
        ),
        front=(*_attention(urgent, links), *_rising(tables, urgent)),
        sections=(
            Section("Robots", (_robots(robots, links, labels),), "all of them", unfolded=True),
            *levels(tables, robots, labels),
            *deviations(tables, labels),
            type_section(tables, robots, types, labels),
            *_quarantine(bad),
        ),
    )


def _verdict(robots: Sequence[Robot], urgent: Sequence[Robot]) -> Summary:
    act, more = sum(robot.urgency is Urgency.ACT for robot in urgent), len(urgent) - FEW
    named = (
        ended(f"{robot.name}: {'; '.join(concern.text for concern in robot.concerns)}")
        for robot in urgent[:FEW]
    )
    lines = (*named, *[f"And {more} more, listed below."] * (more > 0), *_undecided(robots))
    many = f"{len(urgent)} of {len(robots)} robots {'needs' if len(urgent) == 1 else 'need'}"
    if act:
        now = " now" if act == len(urgent) else f", {act} of them now"
        return Summary(Trust.POOR, f"{many} attention{now}.", lines)
    if urgent:
        return Summary(Trust.FAIR, f"{many} attention.", lines)
    if unsure := sum(not robot.is_known for robot in robots):
        said = (
            "No robot is known to need attention, but there is not enough data on "
            f"{unsure} of {len(robots)}."
        )
        return Summary(Trust.UNTESTED, said, lines)
    return Summary(Trust.GOOD, f"None of {len(robots)} robots needs attention.", lines)


def _undecided(robots: Sequence[Robot]) -> list[str]:
    """Undetermined drives, and unused recordings."""
    drives, lines = [row for robot in robots for row in robot.drives], list[str]()
    if unknown := sum(row["state"] == "unknown" for row in drives):
        lines.append(
            f"Not enough data on {unknown} of {len(drives)} drives to say whether their friction "
            "changes."
        )
    if bad := sum(robot.quarantined for robot in robots):
        every = sum(robot.recordings for robot in robots)
        lines.append(f"{bad} of {every} recordings are in quarantine and were not used.")
    return lines + [f"False alarms of changes: {text}." for text in bounds(drives)[:1]]


def _attention(urgent: Sequence[Robot], links: Mapping[str, str]) -> tuple[Block, ...]:
    listed, more = urgent[:MOST], len(urgent) - MOST
    rows = tuple(
        (robot.name, WORDS[robot.urgency], "; ".join(concern.text for concern in robot.concerns))
        for robot in listed
    )
    table = Table(
        ("robot", "how soon", "why"),
        rows,
        "Robots that need attention: act within four weeks, or look when there is time."
        + f" {more} more are the next in the table of all robots." * (more > 0),
        marked=frozenset(range(len(rows))),
        links=tuple(links[robot.name] for robot in listed),
    )
    return (table,) if rows else ()


def _rising(tables: Tables, urgent: Sequence[Robot]) -> tuple[Block, ...]:
    changed = [(robot.name, row) for robot in urgent for row in robot.changed]
    main = tables["friction"].filter(quantity=MAIN)
    panels = [
        friction_panel(f"{name}, {row['drive']}", friction.sort("time"), row)
        for name, row in changed[:MOST]
        if len(friction := main.filter(robot=name, drive=row["drive"]))
    ]
    if not panels:
        return ()
    more = len(changed) - len(panels)
    return (
        Chart(
            grid(panels, min(3, len(panels)), x={"type": "date", "matches": "x"}, legend=True),
            "Friction over time of drives where it changes. Dotted: the day of the change, with "
            "the days it may have been."
            + f" {more} more drives are on the pages of their robots."
            * (more > 0),
        ),
    )


def _robots(robots: Sequence[Robot], links: Mapping[str, str], labels: Mapping[str, str]) -> Table:
    rows = tuple(
        (
            robot.name,
            WORDS[robot.urgency] if robot.concerns or robot.is_known else UNKNOWN,
            labels[robot.type],
            _changed(robot),
            day(robot.until),
            LIKE[robot.belongs],
            day(robot.last),
            str(robot.recordings),
            str(robot.quarantined),
            cell(number, robot.noise, 3),
            cell(percent, robot.worst_error),
        )
        for robot in robots
    )
    return Table(
        ("robot", "state", "type", "friction", "limit on", "like its type", "last recording",
         "recordings", "in quarantine", "noise", "torque error"),
        rows,
        "Noise and torque error, the worst drive's, are those of the last fit. A click on a head "
        "sorts.",
        marked=frozenset(k for k, robot in enumerate(robots) if robot.urgency < Urgency.NONE),
        links=tuple(links[robot.name] for robot in robots),
        choices=(1, 2, 5),
    )  # fmt: skip


def _changed(robot: Robot) -> str:
    """Drives whose friction changes, or the state of all."""
    if kinds := grouped((row["state"], row["drive"]) for row in robot.changed):
        return "; ".join(f"{state} in {' and '.join(names)}" for state, names in kinds.items())
    if not robot.drives:
        return NOTHING
    return "steady" if robot.is_known else UNKNOWN


def _quarantine(bad: pl.DataFrame) -> tuple[Section, ...]:
    """Reasons of the quarantine, the most frequent first."""
    reasons = grouped(
        (_without_name(row["reason"], row["which"]), row["robot"])
        for row in bad.iter_rows(named=True)
    )
    rows = tuple(
        (str(len(whose)), few(list(dict.fromkeys(whose)), 5), said)
        for said, whose in sorted(reasons.items(), key=lambda item: -len(item[1]))[:50]
    )
    blocks = (
        Text("The pages of robots have the recordings one by one, each with its reason."),
        Table(("how many", "of robots", "reason"), rows),
    )
    return (Section("Quarantine", blocks, f"{len(bad)} that could not be used"),) if rows else ()


def _without_name(reason: str, which: str) -> str:
    """A reason without the recording's name, so that equal causes have equal texts."""
    for name in (which, which.replace("\\", "/").rpartition("/")[2]):
        reason = reason.replace(name, "…") if name else reason
    return reason.removeprefix("…: ")
