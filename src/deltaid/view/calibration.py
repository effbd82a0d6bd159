"""A calibrated geometry as lines, tables, figures and a page."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.calibration.calibrate import Calibration
from deltaid.calibration.outlook import NextReadings
from deltaid.calibration.readings import KINDS
from deltaid.calibration.unknowns import TOOL, WORDS
from deltaid.errors import few
from deltaid.estimation.scatter import NORMAL
from deltaid.sensors.planning.offers import PoseKind
from deltaid.view import style
from deltaid.view.drawing import drawing
from deltaid.view.numbers import FEW, percent, with_uncertainty
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card

# Displayed units: thousandths of m and rad, per mille.
_SHOWN = {"m": "mm", "rad": "mrad", "": "‰"}


def session_lines(calibration: Calibration) -> list[str]:
    """Files with their residuals and excluded readings."""
    lines = []
    for x in calibration.sessions:
        grown = f", {x.grown:.2g}× what was stated" if x.grown > 1 else ""
        left = f"residual {1e3 * x.residual:.2g} mm (noise {1e3 * x.noise:.2g} mm{grown})"
        lines.append(f"{x.source}: {_count(x.readings, x.kind)}, {left}")
        if x.excluded:
            lines.append(f"  excluded {few(x.excluded, FEW, '; ')}")
    if (torques := calibration.known.torques) is not None:
        own = [
            name
            for name, by in zip(calibration.names, calibration.decided, strict=True)
            if by == "torques"
        ]
        noise = f", {torques.grown:.2g}× their noise" if torques.grown > 1 else ""
        lines.append(f"{torques.source}: torques{noise}, decide {', '.join(own) or 'no number'}")
    return lines


def _count(number: int, kind: PoseKind) -> str:
    """A number with its noun, such as '1 distance' or '40 touches'."""
    return f"{number} {KINDS[kind].reading if number == 1 else KINDS[kind].readings}"


def next_line(plan: NextReadings, currency: str) -> str:
    """The instrument with the largest gain for its price, and where to take its first readings."""
    places = [
        " to ".join(f"({', '.join(f'{1e3 * value:.0f}' for value in end)})" for end in ends)
        + (f" on {1e3 * block:.0f}" if block else "")
        for ends, block in zip(plan.poses[:FEW], plan.blocks, strict=False)
    ]
    more = ", …" if len(plan.poses) > FEW else ""
    return (
        f"best for its price, {plan.cost:.0f} {currency}: {plan.name}, "
        f"{_count(len(plan.poses), plan.kind)} at {', '.join(places)}{more} mm"
    )


def next_table(calibration: Calibration, plans: Sequence[NextReadings], currency: str) -> Table:
    """Instruments with their price and their effect on positions and sizes, one per row."""
    rows = [("nothing more", "", "", calibration.after)]
    rows += [(plan.name, f"{plan.cost:.0f}", f"{plan.gain:.1f}", plan) for plan in plans]
    return Table(
        ("with", currency, "gain", "positions, mm", "sizes"),
        tuple((*row, f"{1e3 * then.position:.2g}", percent(then.size)) for *row, then in rows),
        f"{len(plans[0].poses)} readings of one instrument each, that which gains most per "
        f"{currency} first. The gain is by how much ½ log det of the positions' covariance falls, "
        "in nats. Of an instrument that was used already only the work is paid.",
        muted=frozenset({0}),
    )


def number_table(calibration: Calibration) -> Table:
    """Deviations with 95 % intervals: one row per kind of number, one column per limb."""
    limbs, rows = calibration.fit.loops.limbs, list[tuple[str, ...]]()
    tools = list(TOOL) if len(TOOL) <= limbs else []
    for kind in calibration.known.kinds:
        if kind in tools[1:]:  # included in the row of the first
            continue
        at = [
            k
            for name in (tools if kind in tools else [kind])
            for k in calibration.known.of_kind(name)
        ]
        values = (1e3 * np.array([calibration.values[at], NORMAL * calibration.std[at]])).T.tolist()
        cells = ["±".join(filter(None, with_uncertainty(*both))) for both in values]
        decided = calibration.sources[int(np.argmax(calibration.shares[:, at].sum(axis=1)))]
        label = "tool x, y, z" if kind in tools else WORDS[kind]
        unit = _SHOWN[calibration.known.numbers[at[0]].unit]
        rows.append((f"{label}, {unit}", *cells, *[""] * (limbs - len(at)), decided))
    return Table(
        ("more than described", *(f"limb {i + 1}" for i in range(limbs)), "from"), tuple(rows)
    )


def calibration_card(calibration: Calibration) -> Card:
    said, readings = summary(calibration), sum(x.readings for x in calibration.sessions)
    return Card(
        f"Geometry of {calibration.described.label}",
        (said.sentence, *calibration.doubts),
        calibration.verdict.partition(": ")[0],
        (("not known", str(len(calibration.open))), ("readings", str(readings))),
        number_table(calibration),
        tuple(("not known", text) for text in _not_known(calibration)),
        (".robot", '.save("robot.yaml")', ".plot()", ".to_frame()", '.report("x.html")'),
        prompt_lines=tuple(session_lines(calibration)),
    )


def _not_known(calibration: Calibration) -> tuple[str, ...]:
    return (*(direction.words for direction in calibration.open), *calibration.unseen)


def summary(calibration: Calibration) -> Summary:
    """The verdict, and combinations and mistakes that the readings do not determine."""
    grade, _, said = calibration.verdict.partition(": ")
    return Summary(
        Trust.GOOD if grade == "good" else Trust.FAIR,
        f"{grade.capitalize()}: {said}.",
        tuple(f"Not known: {text}." for text in _not_known(calibration)),
    )


def calibration_frame(calibration: Calibration) -> pl.DataFrame:
    """Numbers, one per row: value, deviation after and before [m, rad or share], source."""
    return pl.DataFrame(
        {
            "number": list(calibration.names),
            "value": calibration.values,
            "std": calibration.std,
            "before": [number.spread for number in calibration.known.numbers],
            "unit": [number.unit for number in calibration.known.numbers],
            "decided_by": list(calibration.decided),
        }
    )


def calibration_figure(calibration: Calibration) -> go.Figure:
    """Standard deviation of positions over the workspace, before and after [mm]."""
    (x, y, z), known, figure = 1e3 * calibration.places.x.T, calibration.known, go.Figure()
    roots = {"before": known.G, "after": known.G @ calibration.fit.root}
    for k, (name, root) in enumerate(roots.items()):
        errors = 1e3 * calibration.places.errors(root)
        bar = {"title": {"text": f"{name}, mm", "side": "top"}, "orientation": "h",
               "y": 0.56 * (1 - k), "yanchor": "bottom", "len": 0.8}  # fmt: skip
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="markers", name=name,
            scene="scene" if k == 0 else "scene2",
            marker={"size": 4, "color": errors, "colorscale": "Viridis", "colorbar": bar,
                    "cmin": 0, "cmax": errors.max()},
            text=[f"{error:.2g} mm" for error in errors], hoverinfo="text",
        )  # fmt: skip
    # One above the other, because a narrow page has no room for both.
    half = [{"domain": {"x": [0, 1], "y": [0.7 - 0.56 * k, 1 - 0.56 * k]}, "aspectmode": "data"}
            for k in (0, 1)]  # fmt: skip
    return figure.update_layout(scene=half[0], scene2=half[1], showlegend=False, height=760)


def residual_figure(calibration: Calibration) -> go.Figure:
    """Residuals of all readings divided by their standard deviation."""
    figure = go.Figure()
    for part, r in zip(calibration.fit.readings, calibration.fit.residuals, strict=True):
        instrument = part.instrument
        for k in range(r.shape[1]):
            name = f"{instrument.kind} {'xyz'[k]}" if r.shape[1] > 1 else instrument.kind
            figure.add_scatter(x=instrument.rows, y=r[:, k], mode="markers", name=style.label(name))
    return figure.update_layout(
        xaxis_title="row of the file", yaxis_title="residual / its standard deviation", height=320
    )


def calibration_page(calibration: Calibration) -> Page:
    robot, after, before = calibration.described, calibration.after, calibration.before
    return Page(
        title=robot.label,
        subtitle="Geometry from measured poses",
        verdict=summary(calibration),
        drawing=drawing(robot, calibration.fit.loops.kinematics),
        facts=(
            Fact("position", f"{1e3 * after.position:.2g} mm", "standard deviation"),
            Fact("before", f"{1e3 * before.position:.2g} mm", "by the description"),
            Fact("sizes", percent(after.size), "standard deviation across"),
            Fact("readings", str(sum(x.readings for x in calibration.sessions))),
        ),
        warnings=calibration.doubts,
        sections=(
            Section(
                "Numbers", (number_table(calibration),), "more than described, 95 %", unfolded=True
            ),
            Section(
                "Positions over the workspace",
                (Figure(calibration_figure(calibration)),),
                "before and after",
                unfolded=True,
            ),
            Section(
                "Readings",
                (
                    Text("\n\n".join(session_lines(calibration))),
                    Figure(residual_figure(calibration)),
                ),
                "residuals by pose",
            ),
        ),
    )
