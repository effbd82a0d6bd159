"""Stage 1, the robot: chosen from catalogue or folder, described by a form, edited, and shown."""

import contextlib
import re
from functools import cache, partial

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.files import YAML_ENDINGS
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, catalogue_text, described_in, read_text
from deltaid.studio.drafting.interview import drafted, new_step
from deltaid.studio.drafting.questions import KINDS, Question, questions_of
from deltaid.studio.edits import editable_copy
from deltaid.studio.folder import ConflictError
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import live
from deltaid.studio.pages.upload import upload
from deltaid.studio.runs import FinishedRun
from deltaid.studio.session import FileEdit, Session
from deltaid.studio.steps import show_step


async def body(session: Session) -> None:
    robot, name = session.robot(), session.plan.robot or ""
    _pick(session, robot)
    if robot is None:
        parts.note(
            "Begin with the robot of the catalogue that is most like yours and edit a copy, "
            "or describe your own by a few numbers."
        )
        return
    edited = name not in catalogue() and editor(session, name)
    if isinstance(robot, RobotDescription):
        await _show_robot(session, name)
    elif not edited:  # the editor shows the error
        parts.problem(robot)


def _pick(session: Session, robot: RobotDescription | DeltaidError | None) -> None:
    take = partial(_take, session)
    with parts.panel("Pick a robot"):
        options = {name: f"{name} (file of this folder)" for name in session.folder.robots()}
        options |= {name: f"{name}: {_title(name)}" for name in catalogue()}
        chosen = session.plan.robot
        if chosen is not None:
            options.setdefault(chosen, f"{chosen} (missing)")
        with ui.row().classes("w-full items-center"):
            ui.select(
                options,
                value=chosen,
                label="Robot",
                with_input=True,
                on_change=lambda event: take(event.value),
            ).classes("grow").props('aria-label="Robot"')
            if chosen in catalogue():
                ui.button(
                    "Edit a copy of it",
                    on_click=lambda: take(editable_copy(session.folder, chosen or "")),
                )
        # The editor shows what is wrong with a file's text.
        upload(session, "a robot file", read_text, take, YAML_ENDINGS)
        describe(session)
        if isinstance(robot, RobotDescription):
            facts = {
                "robot": robot.label,
                "drives, in the order of q": ", ".join(
                    f"{drive} ({'slides' if robot.is_linear(drive) else 'turns'})"
                    for drive in robot.drives
                ),
                "bodies": ", ".join(robot.bodies),
                "friction": ", ".join(robot.friction) or "none described",
            }
            with ui.element("div").classes("facts"):
                for what, value in facts.items():
                    ui.label(what).classes("dim")
                    ui.label(value)


@cache
def _title(name: str) -> str:
    """Title of a catalogue robot, without parsing its description."""
    title = re.search(r"^title: *(.+)$", catalogue_text(name), re.MULTILINE)
    return title[1].strip("\"' ") if title else name


def _take(session: Session, name: str | None) -> None:
    if name and name != session.plan.robot:
        parts.change(session, robot=name)


async def _show_robot(session: Session, name: str) -> None:
    with parts.panel("See it, and its limits"):
        await live(session, name)
    with parts.panel("What it can reach, and what holds it"):
        ui.label(
            "A page of the robot at rest: reach, limits that end it, condition and torques all "
            "over the workspace."
        ).classes("dim")

        def below(run: FinishedRun) -> None:
            if (run.robot, run.of) == (name, session.stamped(name)):
                parts.report(session, run.file(_PAGE), f"{name}: picture, reach, limits")

        parts.step(
            session, "show", "Draw it", lambda at: show_step(name, f"{at}/{_PAGE}"), below=below
        )


_FILE, _PAGE = "my-robot.yaml", "robot.html"


def describe(session: Session) -> None:
    """A form that keeps its answers until the description is written."""
    answers: dict[str, str] = session.choices.setdefault("own robot", {})
    with ui.expansion("Describe one of your own by a few numbers").classes("w-full") as whole:
        whole.set_value(bool(answers))
        kind = ui.select(
            {key: f"{key}: {text}" for key, text in KINDS.items()}, value="delta", label="Kind"
        ).classes("w-full")
        parts.remembered(session, "own kind", kind)
        name = session.folder.free_name(_FILE)
        ui.label(
            "Lengths are needed, with or without a unit: 235 mm, 0.235. All else is assumed from "
            "them where you leave it empty, and the file says so."
        ).classes("dim")
        fields = ui.refreshable(lambda: _fields(str(kind.value), answers))
        fields()

        async def write() -> None:
            with parts.waiting():
                text = await session.read(
                    drafted, kind.value, name.partition(".")[0], dict(answers)
                )
            session.folder.write(name, text)
            answers.clear()
            parts.change(session, robot=name)

        ui.button(f"Write {name}", on_click=parts.redrawn(write))
        parts.commands(lambda: new_step(str(kind.value), name, answers))
        kind.on_value_change(lambda: fields.refresh())


def _fields(kind: str, answers: dict[str, str]) -> None:
    needed = [question for question in questions_of(kind) if question.assumed is None]
    with ui.element("div").classes("columns"):
        for question in needed:
            _field(question, answers)
    known = ui.expansion("Masses, motors and what else you know").classes("w-full").props("dense")
    with known, ui.element("div").classes("columns"):
        for question in questions_of(kind):
            if question not in needed:
                _field(question, answers)


def _field(question: Question, answers: dict[str, str]) -> None:
    ui.input(
        question.label,
        value=answers.get(question.key, ""),
        on_change=lambda event: answers.update({question.key: str(event.value or "")}),
    ).tooltip(question.how)


# Pause in typing after which the text is checked [s].
_PAUSE = 0.4


def editor(session: Session, name: str) -> bool:
    """An editor of the folder's file; returns whether there is one."""
    if not session.folder.has(name):
        return False
    try:
        now = session.folder.text(name)
    except DeltaidError:  # the stage shows the error
        return False
    with parts.panel(f"Describe it: {name}"):
        ui.label(
            "Lengths in m, masses in kg, angles in degrees where the key ends in _deg. "
            "Keys are explained in the documentation under Command line, The robot file."
        ).classes("dim")
        draft = session.drafts.get(name, FileEdit(now, now))
        if draft.before != now:
            _changed_meanwhile(session, name, draft, now)
        _Editor(session, name, draft)
    return True


def _changed_meanwhile(session: Session, name: str, draft: FileEdit, now: str) -> None:
    """Choice for an edited text whose file has changed meanwhile."""
    parts.note(
        f"{name} has been changed meanwhile, by another tab or program. Below is what you have "
        "written; it is not saved.",
        "doubt",
    )

    def settle(edits: dict[str, FileEdit]) -> None:
        session.drafts.pop(name)
        session.drafts |= edits
        session.store.redraw()

    mine = {name: FileEdit(now, draft.after)}
    with ui.row():
        for label, edits in (("Keep mine", mine), ("Take the file as it is", {})):
            ui.button(label, on_click=partial(settle, edits)).props("outline dense")


class _Editor:
    def __init__(self, session: Session, name: str, draft: FileEdit) -> None:
        self.session, self.name, self.before = session, name, draft.before
        self.field = ui.codemirror(draft.after, language="YAML", line_wrapping=True)
        self.field.classes("w-full").style("height: 26rem").props('aria-label="Robot file"')
        self.said = ui.column().classes("w-full")
        with ui.row():
            save = ui.button("Save", on_click=self._keep)
            undo = ui.button("Undo all", on_click=lambda: self.field.set_value(self.before))
        self.buttons = (save, undo.props("flat"))
        self.place = ui.column()
        self.pause = ui.timer(_PAUSE, self._judge, once=True)
        self.field.on_value_change(self._later)

    def _later(self) -> None:
        """Keep the text, and check it after a pause in typing."""
        if self.field.value == self.before:
            self.session.drafts.pop(self.name, None)
        else:
            self.session.drafts[self.name] = FileEdit(self.before, self.field.value)
        self.pause.cancel()
        with self.place:
            self.pause = ui.timer(_PAUSE, self._judge, once=True)

    def _judge(self) -> None:
        text = self.field.value
        for button in self.buttons:
            button.set_enabled(text != self.before)
        self.said.clear()
        with self.said, parts.showing_errors():
            described_in(text, self.name)
            if text != self.before:
                parts.note("Valid; not saved yet.", "good")

    def _keep(self) -> None:
        text = self.field.value
        draft = self.session.drafts.get(self.name)
        if draft is not None and draft.after != text:
            raise ConflictError(
                "is being edited in another tab too", where=self.name, cure="save it there"
            )
        # If the file has changed meanwhile, the page offers a choice.
        with contextlib.suppress(ConflictError):
            self.session.folder.write(self.name, text, instead_of=self.before)
            self.session.drafts.pop(self.name, None)
        self.session.store.redraw()
