"""Stage 1: the robot. Picked from catalogue or folder, edited as YAML, shown with its limits."""

import re
from functools import cache

from nicegui import events, ui

from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, catalogue_text, described_in
from deltaid.studio.cures import own_copy
from deltaid.studio.folder import ConflictError
from deltaid.studio.look import Problem
from deltaid.studio.pages.parts import attempt, commands, note, panel, problem, report
from deltaid.studio.pages.upload import upload
from deltaid.studio.session import VIEW, Session
from deltaid.studio.steps import show_step

# Seconds without a key before a text is looked at.
_PAUSE = 0.4
_HEIGHT = "26rem"


async def body(session: Session) -> None:
    """The whole stage."""
    robot = session.robot()
    _pick(session, robot)
    if robot is None:
        note(
            "Begin with the robot of the catalogue that is most like yours; edit its lengths, "
            "masses and limits then."
        )
        return
    name = session.plan.robot or ""
    if name not in catalogue():
        _editor(session, name)
    if isinstance(robot, Problem):
        problem(robot)
        return
    session.show()
    _look(session, name)


def _pick(session: Session, robot: RobotDescription | Problem | None) -> None:
    with panel("Pick a robot"):
        own = session.folder.robots()
        options = {name: f"{name} (file of this folder)" for name in own}
        options |= {name: f"{name}: {_title(name)}" for name in catalogue()}
        chosen = session.plan.robot
        if chosen is not None and chosen not in options:
            options[chosen] = f"{chosen} (missing)"
        with ui.row().classes("w-full items-center"):
            ui.select(
                options,
                value=chosen,
                label="Robot",
                with_input=True,
                on_change=lambda event: _take(session, event.value),
            ).classes("grow").props('outlined aria-label="Robot"')
            if chosen in catalogue():
                ui.button("Edit a copy of it", on_click=lambda: _copy(session)).props("no-caps")
        upload(session, "a robot file", lambda file: _take(session, file), (".yaml", ".yml"))
        if isinstance(robot, RobotDescription):
            with ui.element("div").classes("facts"):
                for what, value in _facts(robot):
                    ui.label(what).classes("dim")
                    ui.label(value)


@cache
def _title(name: str) -> str:
    """Of a catalogue robot, without reading all of its description."""
    found = re.search(r"^title: *(.+)$", catalogue_text(name), re.MULTILINE)
    return found[1].strip("\"' ") if found else name


def _facts(robot: RobotDescription) -> list[tuple[str, str]]:
    drives = ", ".join(
        f"{drive} ({'slides' if robot.is_linear(drive) else 'turns'})" for drive in robot.drives
    )
    return [
        ("robot", robot.title or robot.name),
        ("drives, in the order of q", drives),
        ("bodies", ", ".join(robot.bodies)),
        ("friction", ", ".join(robot.friction) or "none described"),
    ]


def _take(session: Session, name: str | None) -> None:
    if name and name != session.plan.robot:
        attempt(lambda: session.store.change(lambda plan: plan.changed(robot=name)))


def _copy(session: Session) -> None:
    def do() -> None:
        name = own_copy(session.folder, session.plan.robot or "")
        session.store.change(lambda plan: plan.changed(robot=name))

    attempt(do)


def _editor(session: Session, name: str) -> None:
    """The text of the robot's file; it is looked at while one types and saved by a button."""
    if not session.folder.has(name):
        return
    with panel(f"Describe it: {name}"):
        ui.label(
            "Lengths in m, masses in kg, angles in degrees where the key ends in _deg. "
            "Keys are explained in the documentation under Command line, The robot file."
        ).classes("dim")
        try:
            before = session.folder.text(name)
        except DeltaidError as error:
            problem(error)
            return
        editor = ui.codemirror(before, language="YAML", line_wrapping=True)
        editor.classes("w-full").style(f"height: {_HEIGHT}")
        editor.props('aria-label="Robot file"')
        said = ui.column().classes("w-full")
        with ui.row():
            save = ui.button("Save").props("no-caps")
            undo = ui.button("Undo all", on_click=lambda: editor.set_value(before)).props(
                "flat no-caps"
            )

        def judge() -> None:
            text = editor.value
            for button in (save, undo):
                button.set_enabled(text != before)
            said.clear()
            with said:
                try:
                    described_in(text, name)
                except DeltaidError as error:
                    problem(error)
                else:
                    if text != before:
                        note("Valid; not saved yet.", "good")

        def keep() -> None:
            try:
                session.folder.write(name, editor.value, instead_of=before)
            except ConflictError as error:
                with said:
                    problem(error)
                return
            session.store.tell()

        save.on_click(lambda: attempt(keep))
        pause = ui.timer(_PAUSE, judge, once=True, active=True)

        def later(_: events.ValueChangeEventArguments[str]) -> None:
            nonlocal pause
            pause.cancel()
            with said:
                pass
            with editor.parent_slot or said:
                pause = ui.timer(_PAUSE, judge, once=True)

        editor.on_value_change(later)


def _look(session: Session, name: str) -> None:
    with panel("Look at it: reach, limits, torques at rest"):
        view = session.view
        if view is not None and view.state == "running":
            with ui.row().classes("items-center"):
                ui.spinner().props('aria-hidden="true"')
                ui.label("drawing the robot …").props("role=status")
        elif view is not None and view.state == "failed":
            what, _, cure = view.error.partition("\n  → ")
            problem(Problem(what, cure=cure))
        else:
            report(session, VIEW, f"{name}: picture, reach, limits")
        commands(lambda: show_step(name, VIEW))
