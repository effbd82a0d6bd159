"""Sections of types on the fleet's page, and the page of each type: mean, differences, outliers."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import polars as pl

from deltaid.errors import counted, few
from deltaid.fleets.site.parts import LIKE, MOST, NOTHING, Data, Panel, cell, grid, known, numbers
from deltaid.fleets.site.state import FOREIGN, Robot, Tables, Urgency, day
from deltaid.view import style
from deltaid.view.numbers import number, span
from deltaid.view.page import Block, Chart, Fact, Page, Section, Summary, Table, Text, Trust

_EVERY = "Friction of every drive of every robot; a dot is a robot."
_LEVELS = "level of every drive"


def levels(tables: Tables, robots: Sequence[Robot], labels: Mapping[str, str]) -> Iterator[Section]:
    panels = [_levels(tables, robots, kind, label) for kind, label in labels.items()]
    panels = [panel for panel in panels if panel.traces[0]["x"]][:MOST]
    if panels:
        figure = grid(panels, columns=min(len(panels), 3), row=300)
        yield Section("Friction of the fleet", (Chart(figure, _EVERY),), f"{_LEVELS}, by type")


def _levels(tables: Tables, robots: Sequence[Robot], kind: str, title: str) -> Panel:
    """Friction of all drives of a type's robots; with its unit where all drives have the same."""
    levels = [
        (robot.name, row["drive"], row["level"])
        for robot in robots
        for row in robot.drives
        if robot.type == kind and row["level"] is not None
    ]
    rows = pl.DataFrame(
        levels, schema={"robot": pl.String, "drive": pl.String, "y": pl.Float64}, orient="row"
    )
    trace = _dots(rows, "y") | {
        "x": rows["drive"].to_list(),
        "hovertemplate": "%{text}: %{y:.3g}<extra></extra>",
    }
    units = tables["drift"]["unit"].unique().to_list()
    unit = units[0] if len(units) == 1 else "unit of the drive"
    return Panel(title, (trace,), unit=f"friction [{unit}]")


def deviations(tables: Tables, labels: Mapping[str, str]) -> tuple[Section, ...]:
    charts = [
        Chart(_deviation_figure(own, names), f"{label}: how its robots differ; a dot is a robot.")
        for kind, label in labels.items()
        if (names := _most_spread(own := tables["members"].filter(type=kind)))
    ]
    said = "how robots of one type differ"
    return (Section("Parameters by type", tuple(charts[:MOST]), said),) if charts else ()


def foreign_count(robots: Sequence[Robot]) -> str:
    """Number of robots that do not belong to their type; a dash where that is known of none."""
    known = [robot.belongs for robot in robots if robot.belongs is not None]
    return str(known.count(False)) if known else NOTHING


def type_section(
    tables: Tables,
    robots: Sequence[Robot],
    types: Mapping[str, str],
    labels: Mapping[str, str],
) -> Section:
    count = Counter(robot.type for robot in robots)
    means = Counter(tables["types"]["type"])
    foreign = {x: foreign_count([robot for robot in robots if robot.type == x]) for x in types}
    rows = tuple((labels[x], str(count[x]), foreign[x], str(means[x])) for x in types)
    table = Table(
        ("type", "robots", "do not belong", "parameters with a type's mean"),
        rows,
        links=tuple(types.values()),
    )
    return Section("Types", (table,), "what the fleet knows of each")


def type_page(
    kind: str,
    label: str,
    tables: Tables,
    robots: Sequence[Robot],
    links: Mapping[str, str],
) -> Page:
    """The page of a type.

    Args:
        kind: its name, or its description's file.
        robots: of all types.
        links: addresses of the robots' pages.
    """
    robots = [robot for robot in robots if robot.type == kind]
    members = tables["members"].filter(type=kind)
    foreign = [robot for robot in robots if robot.belongs is False]
    panel = _levels(tables, robots, kind, "")
    friction = Section("Friction", (Chart(grid([panel], row=280), _EVERY),), _LEVELS)
    return Page(
        title=label,
        subtitle=f"{counted(len(robots), 'robot')}"
        + (f", described by {kind}" if kind != label else ""),
        verdict=_verdict(robots, foreign),
        facts=(
            Fact("robots", str(len(robots))),
            Fact("need attention", str(sum(robot.urgency < Urgency.NONE for robot in robots))),
            Fact("do not belong", foreign_count(robots)),
        ),
        front=(*_foreign(foreign, links), *_deviations(members)),
        sections=(
            _means(tables["types"].filter(type=kind)),
            *((friction,) if panel.traces[0]["x"] else ()),
            Section("Robots", (_robots(robots, members, links),), "all of this type"),
        ),
    )


def _verdict(robots: Sequence[Robot], foreign: Sequence[Robot]) -> Summary:
    compared = sum(robot.belongs is not None for robot in robots)
    if not compared:
        return Summary(Trust.UNTESTED, "Whether its robots are of one type is not known.")
    if not foreign and compared < len(robots):
        said = f"All {compared} robots that could be compared belong to this type; "
        return Summary(Trust.GOOD, f"{said}{len(robots) - compared} could not.")
    if not foreign:
        return Summary(Trust.GOOD, f"All {len(robots)} robots belong to this type.")
    names = few([robot.name for robot in foreign], 10)
    do = "does" if len(foreign) == 1 else "do"
    return Summary(Trust.FAIR, f"{len(foreign)} of {len(robots)} robots {do} not belong: {names}.")


def _foreign(foreign: Sequence[Robot], links: Mapping[str, str]) -> tuple[Block, ...]:
    rows = tuple(
        (robot.name, "; ".join(c.text.removeprefix(FOREIGN) for c in robot.concerns
                             if c.text.startswith(FOREIGN)))
        for robot in foreign
    )  # fmt: skip
    table = Table(
        ("robot", "why it does not belong"), rows, marked=frozenset(range(len(rows))),
        links=tuple(links[robot.name] for robot in foreign),
    )  # fmt: skip
    return (table,) if rows else ()


def _deviations(members: pl.DataFrame) -> tuple[Block, ...]:
    names = _most_spread(members)
    more = members["parameter"].n_unique() - len(names)
    said = (
        "How robots differ from the type's mean, in spreads between robots; a dot is a robot."
        + f" {more} parameters that differ less are omitted." * (more > 0)
    )
    return (Chart(_deviation_figure(members, names), said),) if names else ()


def _means(types: pl.DataFrame) -> Section:
    if types.is_empty():
        return Section("Mean and spread", (Text("No table says what the type's robots share."),))
    rows = tuple(
        (
            row["parameter"],
            *known(row["mean"], row["std"]),
            row["unit"],
            cell(span, row["low"], row["high"]),
            cell(number, row["spread"], 3),
            cell(span, row["spread_low"], row["spread_high"]),
            cell(number, row["prior"]),
            cell(str, row["robots"]),
        )
        for row in types.iter_rows(named=True)
    )
    table = Table(
        ("parameter", "mean", "±", "unit", "95 % interval", "spread", "its 95 % interval", "prior",
         "robots"),
        rows,
        "The spread is the standard deviation between robots, in the same unit.",
    )  # fmt: skip
    notes = dict.fromkeys(text for text in types["remarks"].to_list() if text)
    return Section(
        "Mean and spread",
        (*map(Text, notes), table),
        "what robots have in common",
        unfolded=True,
    )


def _robots(robots: Sequence[Robot], members: pl.DataFrame, links: Mapping[str, str]) -> Table:
    sizes = members.drop_nulls("spreads").with_columns(pl.col("spreads").abs())
    ordered = sizes.sort("spreads", maintain_order=True)
    largest = {
        name: (parameter, cell(number, spreads, 3))
        for name, parameter, spreads in ordered.select("robot", "parameter", "spreads").iter_rows()
    }
    rows = tuple(
        (
            robot.name,
            LIKE[robot.belongs],
            *largest.get(robot.name, (NOTHING, NOTHING)),
            day(robot.last),
            str(robot.recordings),
        )
        for robot in robots
    )
    return Table(
        ("robot", "belongs", "differs most in", "by [spreads]", "last recording", "recordings"),
        rows,
        marked=frozenset(k for k, robot in enumerate(robots) if robot.belongs is False),
        links=tuple(links[robot.name] for robot in robots),
        choices=(1,),
    )


def _dots(rows: pl.DataFrame, value: str) -> Data:
    """A box with a dot for each row, labelled by its robot."""
    return {
        "type": "box",
        "text": [style.label(name) for name in rows["robot"].to_list()],
        "boxpoints": "all",
        "jitter": 0.5,
        "pointpos": 0,
        "marker": {"color": style.MEASURED, "size": 4, "opacity": 0.6},
        "line": {"width": 1},
        "fillcolor": "rgba(0,0,0,0)",
        "hoveron": "points",
    } | {value: numbers(rows[value])}


def _deviation_figure(members: pl.DataFrame, parameters: Sequence[str]) -> Data:
    chosen = members.filter(
        pl.col("parameter").is_in(list(parameters)) & pl.col("spreads").is_not_null()
    ).rename({"spreads": "x"})
    alike, foreign = (
        chosen.filter(pl.col("belongs").fill_null(True) == value) for value in (True, False)
    )
    hover = {"hovertemplate": "%{text}: %{x:.3g}<extra>%{y}</extra>"}
    traces = [
        _dots(alike, "x")
        | {"orientation": "h", **hover, "y": alike["parameter"].to_list(), "name": "robots"}
    ]
    if len(foreign):
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": numbers(foreign["x"]),
                "y": foreign["parameter"].to_list(),
                "text": [style.label(name) for name in foreign["robot"].to_list()],
                "marker": {"color": style.LIMIT, "size": 8, "symbol": "diamond"},
                **hover,
                "name": "robots that do not belong",
            }
        )
    return {
        "data": traces,
        "layout": {
            "height": 26 * len(parameters) + 120,
            "xaxis": {"title": {"text": "deviation from the type's mean [spreads]"}},
            "yaxis": {"categoryorder": "array", "categoryarray": list(parameters)[::-1]},
        },
    }


def _most_spread(members: pl.DataFrame) -> list[str]:
    """Parameters with the largest differences between robots, in the order of the table."""
    sizes = (
        members.drop_nulls("spreads")
        .group_by("parameter", maintain_order=True)
        .agg(pl.col("spreads").abs().max())
    )
    chosen = sizes.sort("spreads", "parameter", descending=[True, False]).head(MOST)["parameter"]
    return sizes.filter(pl.col("parameter").is_in(chosen.to_list()))["parameter"].to_list()
