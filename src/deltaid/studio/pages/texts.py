"""Commands, Python, files and differences as text, to be copied."""

from collections.abc import Callable
from html import escape
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from deltaid.studio.runs import Record
from deltaid.studio.steps import Step


def commands(make: Callable[[], Step], *fields: ValueElement[Any]) -> None:
    """The command line of a step and the Python that does the same, to be copied.

    Args:
        make: the step as it would begin now.
        fields: it follows from; when one changes, so does what is shown.
    """

    def text() -> None:
        step = make()
        ui.label("In the studio's folder:").classes("dim")
        both(step)

    with ui.expansion("Command line and Python of this step").classes("w-full").props("dense"):
        shown = ui.refreshable(text)
        shown()
    for field in fields:
        field.on_value_change(lambda: shown.refresh())


def both(step: Step | Record) -> None:
    """The command line of a step and its Python."""
    code(step.command, "Copy command", "command")
    code(step.python, "Copy Python", "python")


def code(text: str, label: str, kind: str = "") -> None:
    """Text as it stands, with a button that copies it."""
    ui.html(f'<pre class="code {kind}" tabindex="0">{escape(text)}</pre>', sanitize=False).classes(
        "w-full"
    )
    ui.button(label, on_click=lambda: ui.clipboard.write(text)).props("flat dense no-caps")


def difference(text: str) -> None:
    """A unified diff in colours."""
    marks = {"+": "plus", "-": "minus"}
    body = "\n".join(
        f'<span class="{marks.get(line[:1], "")}">{escape(line)}</span>'
        for line in text.splitlines()
    )
    ui.html(f'<div class="diff" tabindex="0">{body}</div>', sanitize=False).classes("w-full")
