"""The form for a robot of one's own: a few lengths, and what else is known of it."""

from nicegui import ui

from deltaid.studio.describe import drafted, new_step
from deltaid.studio.drafting.kinds import KINDS
from deltaid.studio.drafting.questions import Question, asked
from deltaid.studio.look import Problem
from deltaid.studio.pages import parts
from deltaid.studio.session import Session

_FILE = "my-robot.yaml"


def describe(session: Session) -> None:
    """A form whose answers survive until the description is written."""
    answers: dict[str, str] = session.choices.setdefault("own robot", {})
    with ui.expansion("Describe one of your own by a few numbers").classes("w-full") as whole:
        whole.set_value(bool(answers))
        kinds = {key: f"{key}: {text}" for key, text in KINDS.items()}
        kind = ui.select(kinds, value="delta", label="Kind").props("outlined").classes("w-full")
        parts.remembered(session, "own kind", kind)
        name = session.folder.free_name(_FILE)
        ui.label(
            "Lengths are needed, with or without a unit: 235 mm, 0.235. All else is assumed from "
            "them where you leave it empty, and the file says so."
        ).classes("dim")
        fields = ui.refreshable(lambda: _fields(str(kind.value), answers))
        fields()
        said = ui.column().classes("w-full")

        async def write() -> None:
            said.clear()
            given = dict(answers)
            with said, parts.waiting():
                text = await session.glance(drafted, kind.value, name.partition(".")[0], given)
            if isinstance(text, Problem):
                with said:
                    parts.problem(text)
                return
            parts.attempt(lambda: _take(session, name, text))

        ui.button(f"Write {name}", on_click=write).props("no-caps")
        shown = ui.refreshable(lambda: _command(str(kind.value), name, answers))
        with (
            ui.expansion("Command line and Python of this step")
            .classes("w-full")
            .props("dense") as commands
        ):
            shown()
        commands.on_value_change(lambda: shown.refresh())
        kind.on_value_change(lambda: fields.refresh())


def _take(session: Session, name: str, text: str) -> None:
    session.folder.write(name, text)
    session.choices["own robot"].clear()
    session.store.change(lambda plan: plan.changed(robot=name))


def _command(kind: str, name: str, answers: dict[str, str]) -> None:
    step = new_step(kind, name, answers)
    parts.code(step.command, "Copy command", "command")
    parts.code(step.python, "Copy Python", "python")


def _fields(kind: str, answers: dict[str, str]) -> None:
    questions = asked(kind)
    needed = [question for question in questions if question.assumed is None]
    with ui.element("div").classes("columns"):
        for question in needed:
            _field(question, answers)
    with (
        ui.expansion("Masses, motors and what else you know").classes("w-full").props("dense"),
        ui.element("div").classes("columns"),
    ):
        for question in questions:
            if question.assumed is not None:
                _field(question, answers)


def _field(question: Question, answers: dict[str, str]) -> None:
    unit = f" [{question.shown_unit}]" if question.unit else ""
    field = ui.input(
        f"{question.text}{unit}",
        value=answers.get(question.key, ""),
        on_change=lambda event: answers.update({question.key: str(event.value or "")}),
    )
    field.props("outlined dense").tooltip(question.how)
