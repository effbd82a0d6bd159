"""Models side by side: their errors, their numbers, and their torques along a recording."""

from typing import Any

from nicegui import ui

from deltaid.studio.compare import Beside, comparison, torques
from deltaid.studio.look import Problem
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import beside, linked
from deltaid.studio.plan import Used
from deltaid.studio.runs import Run
from deltaid.studio.session import Session, mapping_of
from deltaid.view.numbers import percent

_SHOWN = ["torques", "errors"]


def over_time(session: Session, models: list[Run], chosen: Run) -> None:
    """A panel with everything of some models along one recording."""
    known = {used.file: used for used in session.plan.recordings if session.folder.has(used.file)}
    if not known:
        return
    verified = session.plan.verified
    first = verified.file if verified and verified.file in known else next(iter(known))
    names = {run.folder: _name(session, run) for run in models}
    with parts.panel("Over time, and side by side"):
        with ui.row().classes("items-center w-full"):
            picked = ui.select(names, value=[chosen.folder], label="Models", multiple=True)
            picked.props("outlined dense use-chips").classes("grow")
            along = ui.select(list(known), value=first, label="Recording").props("outlined dense")
            shown = ui.toggle(_SHOWN, value=_SHOWN[0]).props('no-caps aria-label="What is shown"')
        parts.remembered(session, "models along", along)
        parts.remembered(session, "models shown", shown)
        place = ui.column().classes("w-full")

        async def draw() -> None:
            place.clear()
            runs = [run for run in models if run.folder in (picked.value or [])]
            used = known.get(str(along.value))
            with place:
                if runs and used:
                    await _along(session, runs, used, str(shown.value))
                    _numbers(session, runs)
                    _everywhere(session, runs, known)

        for field in (picked, along, shown):
            field.on_value_change(draw)
        ui.timer(0.05, draw, once=True)


def _name(session: Session, run: Run) -> str:
    given = session.plan.names.get(run.folder)
    return f"{run.name} {given}" if given else run.name


async def _look(
    session: Session, runs: list[Run], used: Used, span: Any = None
) -> Beside | Problem:
    path, mapping = str(session.folder.path(used.file)), mapping_of(session, used)
    models = tuple(str(session.folder.path(run.file("model.yaml"))) for run in runs)
    return await session.look(torques, path, mapping, models, span)


async def _along(session: Session, runs: list[Run], used: Used, shown: str) -> None:
    """Torques or errors along a recording, on one time axis for all drives."""
    with parts.waiting():
        found = await _look(session, runs, used)
    if isinstance(found, Problem):
        parts.problem(found)
        return
    names = [_name(session, run) for run in runs]
    _errors(found, names)
    plot = ui.plotly(beside(found, names, shown)).classes("w-full")
    plot.props(f'role=img aria-label="{shown.capitalize()} of models along {used.file}"')

    async def again(span: tuple[float, float] | None) -> Any:
        detail = await _look(session, runs, used, span)
        return None if isinstance(detail, Problem) else beside(detail, names, shown)

    linked(plot, again)


def _errors(found: Beside, names: list[str]) -> None:
    rows = [
        (name, *(percent(float(share)) for share in shares))
        for name, shares in zip(names, found.nrmse, strict=True)
    ]
    parts.table(("error, as a share of the torque", *found.drives), rows)


def _numbers(session: Session, runs: list[Run]) -> None:
    if len(runs) > 1:
        with ui.expansion("Settings, errors and parameters side by side").classes("w-full"):
            parts.table(("", *(run.name for run in runs)), comparison(session.folder, runs))


def _everywhere(session: Session, runs: list[Run], known: dict[str, Used]) -> None:
    """Every model on every recording."""
    if len(known) < 2:
        return

    async def draw() -> None:
        place.clear()
        with place:
            with parts.waiting():
                rows = [(file, *await _shares(session, runs, used)) for file, used in known.items()]
            parts.table(("largest error of a drive", *(_name(session, run) for run in runs)), rows)

    ui.button("On every recording", on_click=draw).props("outline dense no-caps")
    place = ui.column().classes("w-full")


async def _shares(session: Session, runs: list[Run], used: Used) -> list[str]:
    found = await _look(session, runs, used)
    if isinstance(found, Problem):
        return [found.what] * len(runs)
    return [percent(float(shares.max())) for shares in found.nrmse]
