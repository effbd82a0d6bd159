"""A recording as its mapping reads it, thinned by smallest and largest values."""

import plotly.graph_objects as go
from nicegui import ui
from plotly.subplots import make_subplots

from deltaid.studio import look
from deltaid.studio.mapping_edit import Data
from deltaid.studio.pages import parts
from deltaid.studio.plan import Used
from deltaid.studio.session import Session

_COLOURS = ("#1f77b4", "#d9730d", "#2c9a55", "#a64ca6")
_HEIGHT = 190


async def preview(session: Session, used: Used, mapping: Data) -> None:
    """Positions, speeds and torques over time."""
    if not mapping:
        return
    robot = session.place(session.plan.robot or "")
    path = str(session.folder.path(used.file))
    waiting = ui.spinner()
    seen = await session.look(look.preview, path, robot, mapping)
    waiting.delete()
    if isinstance(seen, look.Problem):
        parts.problem(seen)
        return
    ui.label(
        f"{seen.seconds:.4g} s, {seen.rows / max(seen.seconds, 1e-9):.4g} rows a second; "
        "angles in degrees. Do they look like what the robot did?"
    ).classes("dim")
    plot = ui.plotly(figure(seen)).classes("w-full")
    plot.props(f'role=img aria-label="Preview of {used.file}"')


def figure(seen: look.Preview) -> go.Figure:
    """Curves of all drives, one row a quantity, over one time axis."""
    quantities = list(dict.fromkeys(one.quantity for one in seen.curves))
    plot = make_subplots(rows=len(quantities), cols=1, shared_xaxes=True, vertical_spacing=0.04)
    for one in seen.curves:
        row = quantities.index(one.quantity) + 1
        plot.add_trace(
            go.Scattergl(
                x=one.time,
                y=one.values,
                name=f"drive {one.drive + 1}",
                legendgroup=str(one.drive),
                showlegend=row == 1,
                line={"color": _COLOURS[one.drive % len(_COLOURS)], "width": 1},
            ),
            row=row,
            col=1,
        )
        plot.update_yaxes(title_text=f"{one.quantity} [{one.unit}]", row=row, col=1)
    plot.update_xaxes(title_text="time [s]", row=len(quantities), col=1)
    plot.update_xaxes(gridcolor="rgba(128,128,128,.25)", zeroline=False)
    plot.update_yaxes(gridcolor="rgba(128,128,128,.25)", zeroline=False)
    plot.update_layout(
        height=_HEIGHT * len(quantities) + 60,
        margin={"l": 60, "r": 10, "t": 10, "b": 40},
        legend={"orientation": "h", "y": 1.08},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": "#7a8691"},
    )
    return plot
