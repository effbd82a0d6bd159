"""The form of a mapping file: time, and for each quantity and drive its column, unit and sign."""

from collections.abc import Callable
from typing import Any

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.recording.contents import Contents
from deltaid.recording.mapping import QUANTITIES, Quantity
from deltaid.robot.description import RobotDescription
from deltaid.studio.edits import (
    DEFAULTS,
    TIME_UNITS,
    UNITS,
    Data,
    entries,
    incomplete,
    with_time,
    with_value,
    written,
)
from deltaid.studio.folder import ConflictError
from deltaid.studio.pages import parts
from deltaid.studio.plan import Used
from deltaid.studio.session import FileEdit, Session

_NEEDED = ("position", "torque")


class _Form:
    """A form and the data behind it; what is complete and valid is saved at once."""

    def __init__(self, session: Session, used: Used, data: Data, dof: int) -> None:
        assert used.mapping is not None
        self.session, self.name, self.dof = session, used.mapping, dof
        self.data = data
        self.before = session.folder.text(self.name)
        draft = session.drafts.pop(self.name, None)
        if draft is not None and draft.before == self.before:
            session.drafts[self.name] = draft
            self.data = draft.after
        self.alike = True
        self.said = ui.column().classes("w-full")

    def take(self, data: Data) -> None:
        """Keep changed data, in the file if it can be."""
        self.data = data
        self.said.clear()
        missing = incomplete(data, self.dof)
        with self.said:
            self.session.drafts[self.name] = FileEdit(self.before, data)
            if missing:
                parts.note(f"{missing}: {self.name} is not changed as long as it is so.", "doubt")
                return
            try:
                text = written(data, self.name)
                self.session.folder.write(self.name, text, instead_of=self.before)
            except ConflictError as error:
                parts.warn(error)
                self.session.store.tell()
                return
            except DeltaidError as error:
                parts.problem(error)
                return
        self.before = text
        del self.session.drafts[self.name]
        self.session.store.tell()

    def set(self, quantity: Quantity, drive: int, key: str, value: object) -> None:
        """Take a changed value of an entry."""
        self.take(with_value(self.data, quantity, drive, key, value, self.dof, alike=self.alike))


def form(
    session: Session, used: Used, contents: Contents, robot: RobotDescription, data: Data
) -> None:
    """All fields of a mapping."""
    ui.label(f"Kept in {used.mapping}. joint value = sign · unit · (number − zero) / gear").classes(
        "dim"
    )
    state = _Form(session, used, data, len(robot.drives))
    columns, data = [column.address for column in contents.columns], state.data
    if session.drafts.get(state.name) is not None:
        state.take(data)
    _time(state, columns)
    ui.switch(
        "All drives have the same unit and gear",
        value=True,
        on_change=lambda event: setattr(state, "alike", bool(event.value)),
    )
    for quantity in QUANTITIES:
        title = quantity if quantity in _NEEDED else f"{quantity} (if recorded)"
        shown = ui.expansion(title, value=quantity in data or quantity in _NEEDED)
        listed = zip(robot.drives, entries(state.data, quantity, state.dof), strict=True)
        with shown.classes("w-full").props("dense"), ui.element("div").classes("grid drives"):
            for drive, (name, entry) in enumerate(listed):
                _row(state, quantity, drive, name, entry, columns)


def _time(state: _Form, columns: list[str]) -> None:
    given = state.data.get("time", {})
    with ui.row().classes("items-center w-full"):
        column = ui.select(
            columns, value=_known(given.get("column"), columns), label="Time column", clearable=True
        ).props("outlined dense")
        unit = ui.select(
            _with(TIME_UNITS, given.get("unit", "s")), value=given.get("unit", "s"), label="Unit",
            new_value_mode="add-unique", with_input=True,
        ).props("outlined dense").classes("w-32")  # fmt: skip
        rate = ui.input("or samples a second", value=_text(given.get("rate")))
        rate.props("outlined dense").classes("w-48")

    def take() -> None:
        def do() -> None:
            each = parts.number(rate.value, "rate")
            state.take(with_time(state.data, column.value, unit.value, each))

        parts.attempt(do)

    column.on_value_change(take)
    unit.on_value_change(take)
    parts.on_leaving(rate, lambda _: take())


def _row(
    state: _Form, quantity: Quantity, drive: int, name: str, entry: Data, columns: list[str]
) -> None:
    def label(of: str) -> str:
        return f'outlined dense stack-label label="{of}" aria-label="{quantity} of {name}: {of}"'

    def setter(key: str) -> Callable[[Any], None]:
        return lambda event: parts.attempt(lambda: state.set(quantity, drive, key, event.value))

    def numbers(key: str) -> Callable[[str], None]:
        return lambda text: state.set(quantity, drive, key, parts.number(text, key, DEFAULTS[key]))

    ui.label(name).classes("drive")
    ui.select(
        columns, value=_known(entry.get("column"), columns), with_input=True, clearable=True,
        on_change=setter("column"),
    ).props(label("column")).classes("of")  # fmt: skip
    ui.select(
        _with(UNITS[quantity], entry.get("unit")), value=entry.get("unit"),
        new_value_mode="add-unique", with_input=True, on_change=setter("unit"),
    ).props(label("unit"))  # fmt: skip
    ui.select({1: "+", -1: "−"}, value=entry.get("sign", 1), on_change=setter("sign")).props(
        label("sign")
    )
    for key, shown in (("zero", "zero"), ("gear", "gear"), ("torque_constant", "N m per A")):
        if key == "torque_constant" and quantity != "torque":
            ui.label("")
            continue
        field = ui.input(value=_text(entry.get(key, DEFAULTS[key]))).props(label(shown))
        parts.on_leaving(field, numbers(key))


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.10g}"


def _known(value: Any, columns: list[str]) -> Any:
    """A column that the recording has; else it is added, for it stands in the file."""
    if value is not None and value not in columns:
        columns.append(value)
    return value


def _with(units: tuple[str, ...], own: str | None) -> list[str]:
    return [*units, *([own] if own and own not in units else [])]
