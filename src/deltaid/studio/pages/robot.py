"""Stage 1: the robot. Picked from catalogue or folder, edited as YAML, shown with its limits."""

import re
from functools import cache
from pathlib import Path

from nicegui import ui

from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, catalogue_text, read_text
from deltaid.studio.cures import own_copy
from deltaid.studio.look import Problem, told
from deltaid.studio.pages.describe import describe
from deltaid.studio.pages.editor import editor
from deltaid.studio.pages.live import live
from deltaid.studio.pages.parts import attempt, commands, note, panel, problem, report
from deltaid.studio.pages.upload import upload
from deltaid.studio.session import VIEW, Session
from deltaid.studio.steps import show_step

_ENDINGS = (".yaml", ".yml")


async def body(session: Session) -> None:
    """The whole stage."""
    robot = session.robot()
    _pick(session, robot)
    if robot is None:
        note(
            "Begin with the robot of the catalogue that is most like yours and edit a copy, "
            "or describe your own by a few numbers."
        )
        return
    name = session.plan.robot or ""
    edited = name not in catalogue() and editor(session, name)
    if isinstance(robot, Problem):
        if not edited:  # the editor says it
            problem(robot)
        return
    await _look(session, name)


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
        upload(session, "a robot file", _readable, lambda file: _take(session, file), _ENDINGS)
        describe(session)
        if isinstance(robot, RobotDescription):
            with ui.element("div").classes("facts"):
                for what, value in _facts(robot):
                    ui.label(what).classes("dim")
                    ui.label(value)


async def _readable(path: Path) -> Problem | None:
    """Why a file cannot be edited as text; what is wrong with the text is said by the editor."""
    found = told(read_text, path)
    return found if isinstance(found, Problem) else None


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


async def _look(session: Session, name: str) -> None:
    with panel("See it, and its limits"):
        await live(session, name)
    with panel("What it can reach, and what holds it"):
        if not session.is_shown:
            ui.label(
                "A page of the robot at rest: reach, limits that end it, condition and torques "
                "all over the workspace."
            ).classes("dim")
            ui.button("Draw it", on_click=lambda: attempt(session.show)).props("outline no-caps")
        elif session.view is not None and session.view.state == "running":
            with ui.row().classes("items-center"):
                ui.spinner().props('aria-hidden="true"')
                ui.label("drawing the robot …").props("role=status")
        elif session.view is not None and session.view.state == "failed":
            what, _, cure = session.view.error.partition("\n  → ")
            problem(Problem(what, cure=cure))
        else:
            report(session, VIEW, f"{name}: picture, reach, limits")
        commands(lambda: show_step(name, VIEW))
