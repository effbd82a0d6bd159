"""The text of a robot's file: looked at while one types, saved by a button, kept until then."""

import contextlib

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.robot.load import described_in
from deltaid.studio.folder import ConflictError
from deltaid.studio.pages.parts import attempt, note, panel, problem
from deltaid.studio.session import FileEdit, Session

# Seconds without a key before a text is looked at.
_PAUSE = 0.4
_HEIGHT = "26rem"


def editor(session: Session, name: str) -> bool:
    """A file of the folder to be edited; whether there is one that can be."""
    if not session.folder.has(name):
        return False
    try:
        now = session.folder.text(name)
    except DeltaidError:  # the stage says why
        return False
    with panel(f"Describe it: {name}"):
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
    """What is to become of a text whose file is another one by now."""
    note(
        f"{name} has been changed meanwhile, by another tab or program. Below is what you have "
        "written; it is not saved.",
        "doubt",
    )

    def keep() -> None:
        session.drafts[name] = FileEdit(now, draft.after)
        session.store.tell()

    def drop() -> None:
        del session.drafts[name]
        session.store.tell()

    with ui.row():
        ui.button("Keep mine", on_click=keep).props("outline dense no-caps")
        ui.button("Take the file as it is", on_click=drop).props("outline dense no-caps")


class _Editor:
    """A text, what is wrong with it, and its buttons."""

    def __init__(self, session: Session, name: str, draft: FileEdit) -> None:
        self.session, self.name, self.before = session, name, draft.before
        self.field = ui.codemirror(draft.after, language="YAML", line_wrapping=True)
        self.field.classes("w-full").style(f"height: {_HEIGHT}").props('aria-label="Robot file"')
        self.said = ui.column().classes("w-full")
        with ui.row():
            self.save = ui.button("Save", on_click=lambda: attempt(self._keep)).props("no-caps")
            self.undo = ui.button(
                "Undo all", on_click=lambda: self.field.set_value(self.before)
            ).props("flat no-caps")
        self.place = ui.column()
        self.pause = ui.timer(_PAUSE, self._judge, once=True)
        self.field.on_value_change(self._later)

    def _later(self) -> None:
        """Keep what has been written, and look at it after a pause."""
        if self.field.value == self.before:
            self.session.drafts.pop(self.name, None)
        else:
            self.session.drafts[self.name] = FileEdit(self.before, self.field.value)
        self.pause.cancel()
        with self.place:
            self.pause = ui.timer(_PAUSE, self._judge, once=True)

    def _judge(self) -> None:
        text = self.field.value
        for button in (self.save, self.undo):
            button.set_enabled(text != self.before)
        self.said.clear()
        with self.said:
            try:
                described_in(text, self.name)
            except DeltaidError as error:
                problem(error)
            else:
                if text != self.before:
                    note("Valid; not saved yet.", "good")

    def _keep(self) -> None:
        text = self.field.value
        draft = self.session.drafts.get(self.name)
        if draft is not None and draft.after != text:
            raise ConflictError(
                "is being edited in another tab too", where=self.name, cure="save it there"
            )
        # Of a file that has been changed meanwhile the page says what to do.
        with contextlib.suppress(ConflictError):
            self.session.folder.write(self.name, text, instead_of=self.before)
            self.session.drafts.pop(self.name, None)
        self.session.store.tell()
