"""The page of a type: what its robots have in common, how they differ, which do not belong."""

from collections.abc import Mapping, Sequence

import polars as pl

from deltaid.fleets.site.chapters import level_panel
from deltaid.fleets.site.parts import (
    NOTHING,
    between,
    count,
    deviation_figure,
    grid,
    known,
    most_spread,
    shown,
)
from deltaid.fleets.site.state import Robot, Urgency, day
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust


def type_page(
    kind: str,
    label: str,
    robots: Sequence[Robot],
    types: pl.DataFrame,
    members: pl.DataFrame,
    links: Mapping[str, str],
    unit: str,
) -> Page:
    """The page of a type.

    Args:
        kind: its name, or its description's file.
        robots: those of it.
        types, members: its rows of these tables.
        links: addresses of the robots' pages.
        unit: of friction.
    """
    foreign = [robot for robot in robots if robot.belongs is False]
    return Page(
        title=label or "Robots of no type",
        subtitle=f"{len(robots)} robots" + (f", described by {kind}" if kind != label else ""),
        verdict=_verdict(
            robots, foreign, is_known=any(robot.belongs is not None for robot in robots)
        ),
        facts=(
            Fact("robots", str(len(robots))),
            Fact("need attention", str(sum(robot.urgency < Urgency.NONE for robot in robots))),
            Fact(
                "do not belong",
                str(len(foreign))
                if any(robot.belongs is not None for robot in robots)
                else NOTHING,
            ),
        ),
        front=(*_foreign(foreign, links), *_deviations(members)),
        sections=(
            *_means(types),
            *_levels(robots, unit),
            Section("Robots", (_robots(robots, members, links),), "all of this type"),
        ),
    )


def _verdict(robots: Sequence[Robot], foreign: Sequence[Robot], *, is_known: bool) -> Summary:
    if not is_known:
        return Summary(Trust.UNTESTED, "Whether its robots are alike is not known.")
    if not foreign:
        return Summary(Trust.GOOD, f"All {len(robots)} robots belong to this type.")
    names = ", ".join(robot.name for robot in foreign[:10])
    more = f" and {len(foreign) - 10} more" if len(foreign) > 10 else ""
    single = len(foreign) == 1
    said = (
        f"{len(foreign)} of {len(robots)} robots {'does' if single else 'do'} not belong: {names}"
    )
    return Summary(Trust.FAIR, f"{said}{more}.")


def _foreign(foreign: Sequence[Robot], links: Mapping[str, str]) -> tuple[Block, ...]:
    if not foreign:
        return ()
    start = "does not belong to its type: "
    rows = tuple(
        (robot.name, "; ".join(c.text.removeprefix(start) for c in robot.concerns
                             if c.text.startswith(start)))
        for robot in foreign
    )  # fmt: skip
    return (
        Table(("robot", "why it does not belong"), rows, marked=frozenset(range(len(rows))),
              links=tuple(links[robot.name] for robot in foreign)),
    )  # fmt: skip


def _deviations(members: pl.DataFrame) -> tuple[Block, ...]:
    names = most_spread(members)
    if not names:
        return ()
    figure = deviation_figure(members, names)
    more = members["parameter"].n_unique() - len(names)
    said = "How robots differ from the type's mean, in spreads between robots; a dot is a robot."
    return (
        Chart(figure, said + (f" {more} parameters that differ less are left out." * (more > 0))),
    )


def _means(types: pl.DataFrame) -> tuple[Section, ...]:
    """Mean and spread of every parameter."""
    if types.is_empty():
        return (Section("Mean and spread", (Text("No table says what the type's robots share."),)),)
    rows = tuple(
        (
            row["parameter"],
            *known(row["mean"], row["std"]),
            row["unit"],
            between(row["low"], row["high"]),
            shown(row["spread"], 3),
            between(row["spread_low"], row["spread_high"]),
            shown(row["prior"]),
            count(row["robots"]),
        )
        for row in types.iter_rows(named=True)
    )
    columns = ("parameter", "mean", "±", "unit", "95 % interval", "spread", "its 95 % interval",
               "prior", "robots")  # fmt: skip
    said = "The spread is the standard deviation between robots, in the same unit."
    notes = dict.fromkeys(text for text in types["told"].to_list() if text)
    return (
        Section("Mean and spread", (*map(Text, notes), Table(columns, rows, said)),
                "what robots have in common", unfolded=True),
    )  # fmt: skip


def _levels(robots: Sequence[Robot], unit: str) -> tuple[Section, ...]:
    panel = level_panel(robots, "", unit)
    if not panel.traces[0]["x"]:
        return ()
    said = "Friction of every drive of every robot; a dot is a robot."
    return (Section("Friction", (Chart(grid([panel], row=280), said),), "level of every drive"),)


def _robots(robots: Sequence[Robot], members: pl.DataFrame, links: Mapping[str, str]) -> Table:
    """All robots of the type with where they differ most."""
    largest = dict[str, tuple[str, float]]()
    for row in members.iter_rows(named=True):
        if row["spreads"] is None:
            continue
        size = abs(row["spreads"])
        if size >= largest.get(row["robot"], ("", 0.0))[1]:
            largest[row["robot"]] = row["parameter"], size
    rows = tuple(
        (
            robot.name,
            {True: "yes", False: "no", None: NOTHING}[robot.belongs],
            largest.get(robot.name, (NOTHING,))[0],
            shown(largest[robot.name][1], 3) if robot.name in largest else NOTHING,
            day(robot.last),
            str(robot.recordings),
        )
        for robot in robots
    )
    columns = ("robot", "belongs", "differs most in", "by [spreads]", "last recording",
               "recordings")  # fmt: skip
    return Table(
        columns,
        rows,
        marked=frozenset(k for k, robot in enumerate(robots) if robot.belongs is False),
        links=tuple(links[robot.name] for robot in robots),
        choices=(1,),
    )
