"""The page of `deltaid online`: loads and contacts of a recording, cycle by cycle, and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.errors import counted, plural
from deltaid.estimation.scatter import NORMAL
from deltaid.online.events import WeighedLoad
from deltaid.online.watch import Watched
from deltaid.view import style
from deltaid.view.comparison import POINTS, peak_rows
from deltaid.view.numbers import number
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust

_UNTOLD = (
    "No gripper signal: torques do not separate a push straight up or down from a load taken or "
    "released."
)


def online_page(watched: Watched, title: str) -> Page:
    """The page of a recording that `deltaid online` has processed.

    Each stretch of a long recording is drawn by the cycle with its largest residual.
    """
    series = watched.series
    watched = replace(watched, series=series[peak_rows(series["contact_size"].to_numpy(), POINTS)])
    loads = loads_table(watched) if watched.loads else Text("No load was found.")
    touches = touches_table(watched) if watched.touches else Text("No contact was found.")
    return Page(
        title=watched.robot.label,
        subtitle=f"Run through cycle by cycle: {title}",
        facts=(
            Fact(
                "loads",
                str(len(watched.loads)),
                "by the gripper" if watched.has_gripper else "found",
            ),
            Fact("contacts", str(len(watched.touches))),
            Fact(
                "smallest force detected",
                f"{number(watched.worst, 2)} N",
                "on the platform, worst direction",
            ),
            Fact(
                "a cycle",
                f"{1e6 * watched.seconds:.2g} µs",
                f"of {1e6 / watched.rate:.0f} µs there are",
            ),
        ),
        front=(_mass(watched), _size(watched)),
        sections=(
            Section("Loads", (loads,), "mass, interval, centre of each", unfolded=True),
            Section(
                "Contacts", (touches, *_forces(watched)), "when, where, how hard", unfolded=True
            ),
            Section(
                "What can be detected", (_least_forces(watched), *map(Text, result_lines(watched)))
            ),
            Section("Friction", (friction_table(watched),), "what was followed of it"),
        ),
        warnings=watched.doubts,
        verdict=verdict(watched),
    )


def verdict(watched: Watched) -> Summary:
    """Number of loads and contacts; doubtful if there is a warning."""
    loads, touches, doubts = len(watched.loads), len(watched.touches), len(watched.doubts)
    text = (
        f"Done: {counted(loads, 'load')} and {counted(touches, 'contact')} in "
        f"{watched.cycles / watched.rate:.4g} s."
    )
    if not doubts:
        return Summary(Trust.GOOD, text, result_lines(watched))
    which = "a warning" if doubts == 1 else f"{doubts} warnings"
    said = f"Doubtful: read {which} below before any of it is believed."
    return Summary(Trust.FAIR, said, (text, *result_lines(watched)))


def _mass(watched: Watched) -> Figure:
    s = watched.series
    top = max((1.4 * load.mass.value for load in watched.loads), default=1.0)
    high, low = (
        np.where(s["held"].to_numpy() > 0, np.minimum(s[name].to_numpy(), 2 * top), 0.0)
        for name in ("mass_high", "mass_low")
    )
    edge: dict[str, Any] = {"line": {"width": 0, "shape": "hv"}, "hoverinfo": "skip"}
    line = {"color": style.MEASURED, "width": 1.5, "shape": "hv"}
    lines = [
        go.Scatter(y=high, showlegend=False, **edge),
        go.Scatter(y=low, name="95 %", fill="tonexty", fillcolor="rgba(43,131,198,0.3)", **edge),
        _line("held", s["mass"].to_numpy(), "%{y:.3g} kg", line=line),
    ]
    return Figure(
        _over_time(s, lines, {"title": "mass held [kg]", "range": [-0.05 * top, top]}, 340),
        "Mass that is held, as known at each instant, with its 95 % interval.",
    )


def _size(watched: Watched) -> Figure:
    size = watched.series["contact_size"].to_numpy()
    line = _line("residual", size, "%{y:.3g} of the threshold", style.RESIDUAL)
    axis = {"title": "residual [thresholds]", "rangemode": "tozero"}
    figure = _over_time(watched.series, [line.update(showlegend=False)], axis)
    figure.add_hline(y=1.0, line={"color": style.LIMIT, "dash": "dot", "width": 1})
    return Figure(
        figure,
        "What neither model nor load explains of the torques, as a share of the threshold (dotted) "
        f"for {_at_most(watched)}.",
    )


def _forces(watched: Watched) -> tuple[Figure, ...]:
    s = watched.series
    force = {name: s[name].to_numpy() for name in s.columns if name.startswith("force_")}
    lines = [
        _line(f"along {name.removeprefix('force_')}", values, "%{y:.3g} N", style.SERIES[k])
        for k, (name, values) in enumerate(force.items())
    ]
    figure = Figure(
        _over_time(s, lines, {"title": "force on the platform [N]"}),
        "Force on the platform point, in the world's axes, while it is touched.",
    )
    return (figure,) if any(values.any() for values in force.values()) else ()


def _least_forces(watched: Watched) -> Figure:
    s = watched.series
    lines = [
        _line(name, np.where(np.isfinite(values), values, np.nan), "%{y:.3g} N", color)
        for name, values, color in (
            ("best direction", s["least_force_best"].to_numpy(), style.SERIES[0]),
            ("worst direction", s["least_force_worst"].to_numpy(), style.SERIES[1]),
        )
    ]
    return Figure(
        _over_time(s, lines, {"title": "smallest detected force [N]", "rangemode": "tozero"}),
        "Smallest force on the platform that is found in 95 % of cases: it grows with what is not "
        "known yet of a load that was just taken.",
    )


def _line(name: str, values: np.ndarray, hover: str, color: str = "", **look: Any) -> go.Scatter:
    shown = {"line": {"color": color, "width": 1.2}} | look
    hover = f"{hover} at %{{x:.4g}} s<extra></extra>"
    return go.Scatter(y=values, name=name, hovertemplate=hover, **shown)


def _over_time(
    series: pl.DataFrame, lines: Sequence[go.Scatter], axis: Mapping[str, Any], height: int = 300
) -> go.Figure:
    for line in lines:
        line.update(x=series["t"].to_numpy().astype(np.float32), y=np.asarray(line.y, np.float32))
    return go.Figure(lines, {"xaxis": {"title": "time [s]"}, "yaxis": axis, "height": height})


def loads_table(watched: Watched) -> Table:
    last = watched.loads[-1:]
    by = "by the gripper's signal" if watched.has_gripper else "found from torques alone"
    return Table(
        ("taken [s]", "left [s]", "mass [kg]", "95 %", "after 0.2 s [kg]", "centre [mm]"),
        tuple(_load(load, "held still" if load in last else "a hole") for load in watched.loads),
        title=f"Loads, {by}",
    )


def _load(load: WeighedLoad, until: str) -> tuple[str, ...]:
    mass = load.mass
    return (
        f"{load.start:.3f}",
        until if load.end is None else f"{load.end:.3f}",
        f"{mass.value:.3f}",
        f"{mass.low:.3f} to {mass.high:.3f}",
        "left before" if load.soon is None else f"{load.soon[0]:.3f}",
        ", ".join(f"{axis} {1e3 * x:z.0f}" for axis, x in load.centre) or "not shown",
    )


def touches_table(watched: Watched) -> Table:
    rows = tuple(
        (
            f"{touch.start:.3f}",
            f"{1e3 * (touch.end - touch.start):.0f}",
            touch.place if touch.place == "platform" else f"limb of {touch.place}",
            f"{number(touch.strength, 3)} "
            f"{'N' if touch.force else watched.robot.units(touch.place).force}",
            number(touch.size, 3),
        )
        for touch in watched.touches
    )
    return Table(("at [s]", "for [ms]", "place", "size", "of threshold"), rows, title="Contacts")


def friction_table(watched: Watched) -> Table:
    return Table(
        ("friction", "model", "now", "95 %", "unit"),
        tuple(
            (
                term.name,
                number(term.before, 3),
                number(term.value, 3),
                f"± {number(NORMAL * term.std, 2)}",
                term.unit,
            )
            for term in watched.friction
        ),
        title="Friction, followed",
    )


def _at_most(watched: Watched) -> str:
    alarms = plural("false alarm", watched.false_alarms)
    return f"at most {watched.false_alarms:g} {alarms} an hour"


def result_lines(watched: Watched) -> tuple[str, ...]:
    """Smallest detectable force, unused cycles, and the computing time of a cycle."""
    bad = f"{watched.bad} of {watched.cycles} cycles could not be used"
    return (
        f"Smallest detected force on the platform: {number(watched.best, 2)} N along the best "
        f"direction, {number(watched.worst, 2)} N along the worst (95 % of cases, "
        f"{_at_most(watched)}).",
        *(() if watched.has_gripper else (_UNTOLD,)),
        *((bad,) if watched.bad else ()),
        f"{watched.cycles} cycles at {watched.rate:.5g} Hz, {1e6 * watched.seconds:.2g} µs each",
    )
