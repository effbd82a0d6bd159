"""Stage 2: recordings. Files of the folder, which column is what, and a preview."""

from functools import partial
from typing import Any

from nicegui import events, ui

from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription
from deltaid.studio import look
from deltaid.studio.mapping_edit import Data, read, written
from deltaid.studio.pages import parts
from deltaid.studio.pages.mapping import form
from deltaid.studio.pages.preview import preview
from deltaid.studio.pages.upload import upload
from deltaid.studio.plan import Used
from deltaid.studio.session import Session, mapping_name

_USES = {"fit": "fit the model to it", "verify": "test the model on it", "aside": "leave it aside"}


async def body(session: Session) -> None:
    """The whole stage."""
    robot = session.robot()
    if not isinstance(robot, RobotDescription):
        parts.note("Pick a robot first: columns are proposed for its drives.")
        return
    _files(session)
    for used in session.plan.recordings:
        if used.use != "aside":
            await _recording(session, used, robot)


def _files(session: Session) -> None:
    with parts.panel("Recordings"):
        upload(session, "a recording", lambda file: _add(session, file))
        ui.label(
            "CSV, Parquet, MATLAB, NumPy, HDF5, TwinCAT scopes, ROS bags; any names of columns."
        ).classes("dim")
        known = {one.file: one for one in session.plan.recordings}
        for name in dict.fromkeys((*known, *session.folder.recordings())):
            with ui.row().classes("items-center w-full"):
                ui.label(name).classes("grow")
                used = known.get(name)
                if used is None:
                    ui.button("Use it", on_click=partial(_add, session, name)).props(
                        f'outline dense no-caps aria-label="Use {name}"'
                    )
                    continue
                if not session.folder.has(name):
                    ui.label("is missing").classes("grade wrong")
                ui.select(
                    _USES,
                    value=used.use,
                    on_change=partial(_use, session, used),
                ).props(f'dense outlined aria-label="What {name} is for"')


def _add(session: Session, name: str) -> None:
    """Take a recording; the second one tests, and shares the first one's mapping if it fits."""

    def do() -> None:
        plan = session.plan
        first = plan.fitted[0] if plan.fitted else None
        use = "verify" if plan.fitted and not plan.verified else "fit"
        mapping = first.mapping if first is not None else None
        session.store.change(lambda p: p.with_recording(Used(file=name, mapping=mapping, use=use)))

    parts.attempt(do)


def _use(session: Session, used: Used, event: events.ValueChangeEventArguments[Any]) -> None:
    changed = used.changed(use=event.value)
    parts.attempt(lambda: session.store.change(lambda plan: plan.with_recording(changed)))


async def _recording(session: Session, used: Used, robot: RobotDescription) -> None:
    with parts.panel(f"{used.file}: which column is what"):
        if not session.folder.has(used.file):
            parts.note(f"{used.file} is no longer in the folder.", "bad")
            return
        linear = tuple(robot.is_linear(drive) for drive in robot.drives)
        path = str(session.folder.path(used.file))
        waiting = ui.spinner()
        held = await session.look(look.held, path, linear)
        waiting.delete()
        if isinstance(held, look.Problem):
            parts.problem(held)
            return
        size = f"{held.rows:,} rows".replace(",", " ")
        ui.label(f"{size}, {len(held.columns)} columns").classes("dim")
        for text in held.warnings:
            parts.note(text, "doubt")
        if used.mapping is None:
            _proposal(session, used, held, robot)
            await preview(session, used, held.guess.data)
            return
        try:
            data = read(session.folder.text(used.mapping), used.mapping)
        except DeltaidError as error:
            parts.problem(error)
            return
        form(session, used, held, robot, data)
        await preview(session, used, data)


def _proposal(session: Session, used: Used, held: look.Held, robot: RobotDescription) -> None:
    """What may be right, and why; a file is written when the user takes it."""
    guess, name = held.guess, mapping_name(session, used.file)
    lines = [f"· {reason}" for reason in guess.reasons]
    if guess.missing:
        lines.append(f"· not found: {', '.join(guess.missing)}; say below which column it is")
    parts.note("Proposed, and not used yet:\n" + "\n".join(lines))
    with ui.row():
        ui.button(
            f"Use these, write {name}", on_click=lambda: _take(session, used, name, guess.data)
        ).props("no-caps")
    others = [one for one in session.folder.mappings() if one != name]
    if others:
        ui.select(
            others,
            label="or take a mapping file of the folder",
            on_change=lambda event: _point(session, used, event.value),
        ).props("outlined dense").classes("w-full")


def _take(session: Session, used: Used, name: str, data: Data) -> None:
    def do() -> None:
        session.folder.write(name, written(data, name))
        session.store.change(lambda plan: plan.with_recording(used.changed(mapping=name)))

    parts.attempt(do)


def _point(session: Session, used: Used, name: str) -> None:
    parts.attempt(
        lambda: session.store.change(lambda plan: plan.with_recording(used.changed(mapping=name)))
    )
