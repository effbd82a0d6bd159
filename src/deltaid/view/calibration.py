"""A calibrated geometry as lines, tables, figures and a page."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
import polars as pl

from deltaid.calibration.calibrate import Calibration
from deltaid.calibration.outlook import NextReadings
from deltaid.calibration.readings import KINDS
from deltaid.calibration.unknowns import TOOL, WORDS
from deltaid.view import style
from deltaid.view.drawing import drawing
from deltaid.view.numbers import FEW, WIDTH, percent, with_uncertainty
from deltaid.view.page import Fact, Figure, Page, Section, Summary, Table, Text, Trust
from deltaid.view.show import Card

# Units that numbers are shown in: 1000 to m and rad, per mille.
_SHOWN = {"m": "mm", "rad": "mrad", "": "‰"}


def session_lines(found: Calibration) -> list[str]:
    """Each file with its residual and what was excluded."""
    lines = []
    for x in found.sessions:
        grown = f", {x.grown:.2g}× what was stated" if x.grown > 1 else ""
        left = f"residual {1e3 * x.residual:.2g} mm (noise {1e3 * x.noise:.2g} mm{grown})"
        lines.append(f"{x.source}: {x.readings} {KINDS[x.kind].readings}, {left}")
        if x.excluded:
            more = f"; and {len(x.excluded) - FEW} more" if len(x.excluded) > FEW else ""
            lines.append(f"  excluded {'; '.join(x.excluded[:FEW])}{more}")
    if (torques := found.known.torques) is not None:
        own = [name for name, by in zip(found.names, found.decided, strict=True) if by == "torques"]
        noise = f", {torques.grown:.2g}× their noise" if torques.grown > 1 else ""
        lines.append(f"{torques.source}: torques{noise}, decide {', '.join(own) or 'no number'}")
    return lines


def next_line(plan: NextReadings, currency: str) -> str:
    """The instrument that is worth its price most, and where its first readings are to be."""
    places = [
        " to ".join(f"({', '.join(f'{1e3 * value:.0f}' for value in end)})" for end in ends)
        + (f" on {1e3 * block:.0f}" if block else "")
        for ends, block in zip(plan.poses[:FEW], plan.blocks, strict=False)
    ]
    more = ", …" if len(plan.poses) > FEW else ""
    return (
        f"best for its price, {plan.cost:.0f} {currency}: {plan.name}, "
        f"{len(plan.poses)} {KINDS[plan.kind].readings} at {', '.join(places)}{more} mm"
    )


def next_table(found: Calibration, plans: Sequence[NextReadings], currency: str) -> Table:
    """A row an instrument: its price, and what it makes of positions and sizes."""
    rows = [("nothing more", "", "", found.after)]
    rows += [(plan.name, f"{plan.cost:.0f}", f"{plan.gain:.1f}", plan) for plan in plans]
    return Table(
        ("with", currency, "gain", "positions, mm", "sizes"),
        tuple((*row, f"{1e3 * then.position:.2g}", percent(then.size)) for *row, then in rows),
        f"{len(plans[0].poses)} readings of one instrument each, that which gains most per "
        f"{currency} first. The gain is by how much ½ log det of the positions' covariance falls, "
        "in nats. Of an instrument that was used already only the work is paid.",
        muted=frozenset({0}),
    )


def number_table(found: Calibration) -> Table:
    """A row a kind of number, a column a limb: how much it exceeds the described one, 95 %."""
    limbs, rows = found.fit.loops.limbs, list[tuple[str, ...]]()
    tools = list(TOOL) if len(TOOL) <= limbs else []
    for kind in found.known.kinds:
        if kind in tools[1:]:  # in the row of the first
            continue
        at = [k for name in (tools if kind in tools else [kind]) for k in found.known.of_kind(name)]
        values = (1e3 * np.array([found.values[at], WIDTH * found.std[at]])).T.tolist()
        cells = ["±".join(filter(None, with_uncertainty(*both))) for both in values]
        decided = found.sources[int(np.argmax(found.shares[:, at].sum(axis=1)))]
        label = "tool x, y, z" if kind in tools else WORDS[kind]
        unit = _SHOWN[found.known.numbers[at[0]].unit]
        rows.append((f"{label}, {unit}", *cells, *[""] * (limbs - len(at)), decided))
    head = ("more than described", *(f"limb {i + 1}" for i in range(limbs)), "from")
    return Table(head, tuple(rows))


def calibration_card(found: Calibration) -> Card:
    """For prompts and notebooks."""
    said, readings = _summary(found), sum(x.readings for x in found.sessions)
    return Card(
        f"Geometry of {found.described.title or found.described.name}",
        (said.sentence, *found.doubts),
        found.verdict.partition(": ")[0],
        (("not known", str(len(found.open))), ("readings", str(readings))),
        number_table(found),
        tuple(("not known", direction.words) for direction in found.open),
        (".robot", '.save("robot.yaml")', ".plot()", ".to_frame()", '.report("x.html")'),
        told=tuple(session_lines(found)),
    )


def _summary(found: Calibration) -> Summary:
    grade, _, said = found.verdict.partition(": ")
    lines = tuple(f"Not known: {direction.words}." for direction in found.open)
    trust = Trust.GOOD if grade == "good" else Trust.FAIR
    return Summary(trust, f"{grade.capitalize()}: {said}.", lines)


def calibration_frame(found: Calibration) -> pl.DataFrame:
    """A number a row: value, standard deviation after and before [m, rad or share], source."""
    return pl.DataFrame(
        {
            "number": list(found.names),
            "value": found.values,
            "std": found.std,
            "before": [number.spread for number in found.known.numbers],
            "unit": [number.unit for number in found.known.numbers],
            "decided_by": list(found.decided),
        }
    )


def calibration_figure(found: Calibration) -> go.Figure:
    """Standard deviation of positions over the workspace, before and after [mm]."""
    (x, y, z), known, figure = 1e3 * found.places.x.T, found.known, go.Figure()
    roots = {"before": known.G, "after": known.G @ found.fit.root}
    for k, (name, root) in enumerate(roots.items()):
        errors = 1e3 * found.places.errors(root)
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="markers", name=name,
            scene="scene" if k == 0 else "scene2",
            marker={"size": 4, "color": errors, "colorscale": "Viridis", "cmin": 0,
                    "colorbar": {"title": f"{name}, mm", "x": 0.45 + 0.55 * k, "len": 0.8}},
            text=[f"{error:.2g} mm" for error in errors], hoverinfo="text",
        )  # fmt: skip
    half = [{"domain": {"x": [0.55 * k, 0.45 + 0.55 * k]}, "aspectmode": "data"} for k in (0, 1)]
    return figure.update_layout(scene=half[0], scene2=half[1], showlegend=False, height=420)


def residual_figure(found: Calibration) -> go.Figure:
    """Residuals of every reading over their standard deviation."""
    figure = go.Figure()
    for part, r in zip(found.fit.readings, found.fit.residuals, strict=True):
        instrument = part.instrument
        for k in range(r.shape[1]):
            name = f"{instrument.kind} {'xyz'[k]}" if r.shape[1] > 1 else instrument.kind
            figure.add_scatter(x=instrument.rows, y=r[:, k], mode="markers", name=style.label(name))
    return figure.update_layout(
        xaxis_title="row of the file", yaxis_title="residual / its standard deviation", height=320
    )


def calibration_page(found: Calibration) -> Page:
    """Everything that a calibration says."""
    robot, after, before = found.described, found.after, found.before
    return Page(
        title=robot.title or robot.name,
        subtitle="Geometry from measured poses",
        verdict=_summary(found),
        drawing=drawing(robot, found.fit.loops.kinematics),
        facts=(
            Fact("position", f"{1e3 * after.position:.2g} mm", "standard deviation"),
            Fact("before", f"{1e3 * before.position:.2g} mm", "by the description"),
            Fact("sizes", percent(after.size), "standard deviation across"),
            Fact("readings", str(sum(x.readings for x in found.sessions))),
        ),
        warnings=found.doubts,
        sections=(
            Section("Numbers", (number_table(found),), "more than described, 95 %", unfolded=True),
            Section(
                "Positions over the workspace",
                (Figure(calibration_figure(found)),),
                "before and after",
                unfolded=True,
            ),
            Section(
                "Readings",
                (Text("\n\n".join(session_lines(found))), Figure(residual_figure(found))),
                "residuals by pose",
            ),
        ),
    )
