"""A recording as its mapping reads it, thinned by smallest and largest values."""

from nicegui import ui

from deltaid.studio import look
from deltaid.studio.mapping_edit import Data
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import Options, Span, curves, linked
from deltaid.studio.plan import Used
from deltaid.studio.session import Session


async def preview(session: Session, used: Used, mapping: Data) -> None:
    """Positions, speeds and torques over time."""
    if not mapping:
        return
    robot = session.place(session.plan.robot or "")
    path = str(session.folder.path(used.file))
    with parts.waiting():
        seen = await session.look(look.preview, path, robot, mapping)
    if isinstance(seen, look.Problem):
        parts.problem(seen)
        return
    ui.label(
        f"{seen.seconds:.4g} s, {seen.rows / max(seen.seconds, 1e-9):.4g} rows a second; "
        "angles in degrees. Do they look like what the robot did?"
    ).classes("dim")
    plot = ui.plotly(curves(seen)).classes("w-full")
    plot.props(f'role=img aria-label="Preview of {used.file}"')

    async def again(span: Span | None) -> Options | None:
        detail = await session.look(look.preview, path, robot, mapping, look.POINTS, span)
        return None if isinstance(detail, look.Problem) else curves(detail)

    linked(plot, again)
