"""Figures of the studio: curves over one time axis, legible on light and dark ground."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Literal

import plotly.graph_objects as go
from nicegui import events, ui

from deltaid.recording.contents import Contents
from deltaid.studio import look
from deltaid.studio.compare import Beside
from deltaid.studio.edits import NEEDED, Data, named
from deltaid.studio.look import Preview
from deltaid.studio.pages import parts
from deltaid.studio.plan import Used
from deltaid.studio.session import Session
from deltaid.view.style import stacked

Options = dict[str, Any]
Span = tuple[float, float]

_COLOURS = ("#1f77b4", "#d9730d", "#2c9a55", "#a64ca6")
_MEASURED = "#8a949e"
_GRID = "rgba(128,128,128,.25)"
# Height of a row of curves [px], and letters of a title beside it.
_HEIGHT, _LETTERS = 190, 26
# Columns that are drawn before any is mapped.
_MOST = 9
_CONFIG = {"config": {"displaylogo": False}}


def curves(seen: Preview, time: str = "time [s]") -> Options:
    """Curves of all drives, one row a quantity, over one time axis."""
    titles = {
        c.quantity: f"{c.quantity} [{c.unit}]" if c.unit else c.quantity[-_LETTERS:]
        for c in seen.curves
    }
    plot, rows = _panels(list(titles.values()), time), list(titles)
    for curve in seen.curves:
        row = rows.index(curve.quantity) + 1
        plot.add_scatter(
            x=curve.time,
            y=curve.values,
            name=f"drive {curve.drive + 1}" if curve.unit else curve.name,
            legendgroup=str(curve.drive),
            showlegend=row == 1 and bool(curve.unit),
            line={"color": _COLOURS[curve.drive % len(_COLOURS)], "width": 1},
            row=row,
            col=1,
        )
    return plot.to_plotly_json() | _CONFIG


def beside(found: Beside, names: Sequence[str], shown: str) -> Options:
    """Torques or errors, a row a drive; the time axes move together.

    Args:
        found: measured and predicted torques.
        names: of the models.
        shown: 'torques' or 'errors'.
    """
    pairs = zip(found.drives, found.units, strict=True)
    plot = _panels([f"{drive} [{unit}]" for drive, unit in pairs])
    for line in found.torques if shown == "torques" else found.errors:
        name, drawn = "measured", {"color": _MEASURED, "width": 2.5}
        if line.model is not None:
            name = names[line.model]
            drawn = {"color": _COLOURS[line.model % len(_COLOURS)], "width": 1.2}
        plot.add_scatter(
            x=line.time,
            y=line.values,
            name=name,
            legendgroup=name,
            showlegend=line.drive == 0,
            line=drawn,
            row=line.drive + 1,
            col=1,
        )
    return plot.to_plotly_json() | _CONFIG


def _panels(titles: Sequence[str], time: str = "time [s]") -> go.Figure:
    plot = stacked(titles, height=_HEIGHT * len(titles) + 60, spacing=0.04, time=time)
    plot.update_xaxes(gridcolor=_GRID, zeroline=False)
    plot.update_yaxes(gridcolor=_GRID, zeroline=False)
    return plot.update_layout(
        margin={"l": 60, "r": 10, "t": 10, "b": 40},
        legend={"orientation": "h", "y": 1.08},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": "#7a8691"},
        hovermode="x unified",
        hoversubplots="axis",
        uirevision="same",  # what one looks at stays when curves come in more detail
    )


def linked(plot: ui.plotly, again: Callable[[Span | None], Awaitable[Options | None]]) -> None:
    """Draw a figure in more detail when one looks at a part of its time.

    Args:
        plot: with one time axis for all rows.
        again: gives the figure of a span [s], or of all time for None.
    """

    async def looked(event: events.GenericEventArguments) -> None:
        asked = _span(event.args)
        if asked is not False:
            figure = await again(asked)
            if figure is not None:
                plot.update_figure(figure)

    plot.on("plotly_relayout", looked)


def _span(said: Mapping[str, Any]) -> Span | Literal[False] | None:
    """The time that is looked at after a change of view; False if it has not changed."""
    for key, value in said.items():
        if key.startswith("xaxis") and key.endswith(".autorange"):
            return None
        if key.startswith("xaxis") and key.endswith(".range[0]"):
            return float(value), float(said[key.replace("[0]", "[1]")])
    return False


async def preview(session: Session, used: Used, mapping: Data) -> None:
    """Positions, speeds and torques over time."""
    if not mapping:
        return
    robot, said = session.place(session.plan.robot or ""), ui.label().classes("dim")
    seen = await _drawn(session, used, look.preview, (robot, mapping))
    if seen is not None:
        said.set_text(
            f"{seen.seconds:.4g} s, {(seen.rows - 1) / max(seen.seconds, 1e-9):.4g} rows a second; "
            "angles in degrees. Do they look like what the robot did?"
        )


async def signals(
    session: Session, used: Used, contents: Contents, mapping: Data, dof: int
) -> None:
    """Columns as they are recorded, before they are mapped: those proposed, or any other."""
    known = [c.address for c in contents.columns if c.low is not None]
    time = mapping.get("time", {}).get("column")
    time = time if time in known else None
    known = [name for name in known if name != time]
    chosen = [name for name in known if name in named(mapping, dof)]
    moving = [c.address for c in contents.columns if c.address in known and not c.is_constant]
    if len(chosen) < len(known) and any(quantity not in mapping for quantity in NEEDED):
        chosen = [*dict.fromkeys((*chosen, *moving))][:_MOST]
    picked = ui.select(known, value=chosen, label="Signals as recorded", multiple=True)
    picked.props("outlined dense use-chips").classes("w-full")
    place = ui.column().classes("w-full")

    async def draw() -> None:
        place.clear()
        with place:
            if picked.value:
                await _drawn(
                    session, used, look.signals, (time, tuple(picked.value)), time or "row"
                )

    parts.remembered(session, f"signals of {used.file}", picked)
    picked.on_value_change(draw)
    await draw()


async def _drawn(
    session: Session, used: Used, see: Callable[..., Preview], given: tuple[Any, ...],
    time: str = "time [s]",
) -> Preview | None:  # fmt: skip
    """The figure of a look at a recording, which is drawn again in more detail; None without."""
    path = str(session.folder.path(used.file))
    with parts.waiting():
        seen = await session.look(see, path, *given)
    if isinstance(seen, look.Problem):
        parts.problem(seen)
        return None
    plot = ui.plotly(curves(seen, time)).classes("w-full")
    plot.props(f'role=img aria-label="Preview of {used.file}"')

    async def again(span: Span | None) -> Options | None:
        detail = await session.look(see, path, *given, look.POINTS, span)
        return None if isinstance(detail, look.Problem) else curves(detail, time)

    linked(plot, again)
    return seen
