"""The form of a mapping: time, and for each quantity and drive its column, unit and sign."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from deltaid.errors import DeltaidError
from deltaid.recording.contents import Contents
from deltaid.recording.mapped_columns import NEEDED_OF_DRIVES, QUANTITIES, Quantity
from deltaid.robot.description import RobotDescription
from deltaid.studio.edits import (
    DEFAULTS,
    TIME_UNITS,
    UNITS,
    Data,
    entries,
    incomplete,
    with_column,
    with_time,
    with_value,
    written,
)
from deltaid.studio.pages import parts
from deltaid.studio.plan import Used
from deltaid.studio.session import FileEdit, Session, draft_key
from deltaid.studio.steps import typed

# Numeric keys of an entry, with the labels of their fields.
_NUMBERS = {"zero": "zero", "gear": "gear", "torque_constant": "N m per A"}


class Form:
    """A form and its data.

    Complete and valid data of a mapping file are saved at once. A proposed mapping is kept as a
    draft until the user accepts it.

    A change updates the fields that it affects and keeps what the user types meanwhile. Other tabs
    redraw the page, and this one only if another recording shares the mapping.

    Attributes:
        key: of its draft: the mapping file, or the recording that has none yet.
        names: of all columns of the recording.
        fields: by quantity, drive and key.
        changed: called after each change.
    """

    def __init__(
        self, session: Session, used: Used, contents: Contents, robot: RobotDescription, data: Data
    ) -> None:
        self.session, self.name, self.robot = session, used.mapping, robot
        self.drives, self.dof = tuple(robot.drives), len(robot.drives)
        self.key, self.names = draft_key(used), [c.address for c in contents.columns]
        self.before = session.folder.text(used.mapping) if used.mapping else ""
        self.fields: dict[tuple[Quantity, int, str], ValueElement[Any]] = {}
        self.changed: list[Callable[[], object]] = []
        sharing = [r for r in session.plan.recordings if r.mapping == used.mapping]
        self.shown_by = "" if used.mapping and len(sharing) > 1 else ui.context.client.id
        self.data, draft = data, session.drafts.get(self.key)
        if draft is not None and draft.before == self.before:
            self.data = draft.after
        elif draft is not None:
            del session.drafts[self.key]

    @property
    def missing(self) -> str:
        """What is missing before a check can begin; empty if nothing is."""
        return incomplete(self.data, self.drives, self.names)

    def take(self, data: Data) -> None:
        """Store changed data, in the file if there is one and the data are valid."""
        self.data = data
        self.session.drafts[self.key] = FileEdit(self.before, data)
        try:
            if self.name is not None and not self.missing:
                text = written(data, self.name)
                self.session.folder.write(self.name, text, instead_of=self.before)
                del self.session.drafts[self.key]
                self.before = text
        except DeltaidError:
            self.shown_by = ""
            raise
        finally:
            for show in self.changed:
                show()
            self.session.store.redraw(self.shown_by)

    def shown(self, quantity: Quantity, drive: int, key: str) -> Any:
        """Value of the field of an entry's key."""
        value = entries(self.data, quantity, self.dof)[drive].get(key, DEFAULTS.get(key))
        return typed(value) if key in _NUMBERS else value

    def refresh(self) -> None:
        """Update each field from the data."""
        for place, field in self.fields.items():
            value, known = self.shown(*place), getattr(field, "options", None)
            if field.value == value:
                continue
            if isinstance(field, ui.select) and isinstance(known, list) and value not in known:
                field.set_options([*known, value] if value else known, value=value)
            else:
                field.set_value(value)

    def set(self, quantity: Quantity, drive: int, key: str, value: Any) -> None:
        """Accept a changed value of an entry."""
        entry = entries(self.data, quantity, self.dof)[drive]
        if value == entry.get(key, DEFAULTS.get(key)):
            return
        alike = bool(self.session.choices.get("alike", True))  # all drives share unit and gear
        given = self.data, quantity, drive
        self.take(
            with_column(*given, value, self.names, self.dof, alike=alike)
            if key == "column"
            else with_value(*given, key, value, self.dof, alike=alike)
        )


def form(state: Form) -> None:
    kept = f"Kept in {state.name}. " if state.name else ""
    ui.label(f"{kept}joint value = sign · unit · (number − zero) / gear").classes("dim")
    _time(state)
    parts.remembered(
        state.session, "alike", ui.switch("All drives have the same unit and gear", value=True)
    )
    for quantity in QUANTITIES:
        title = quantity if quantity in NEEDED_OF_DRIVES else f"{quantity} (if recorded)"
        shown = ui.expansion(title, value=quantity in state.data or quantity in NEEDED_OF_DRIVES)
        listed = zip(state.drives, entries(state.data, quantity, state.dof), strict=True)
        with shown.classes("w-full").props("dense"), ui.element("div").classes("grid drives"):
            for drive, (name, entry) in enumerate(listed):
                _row(state, quantity, drive, name, entry)

    def say() -> None:
        if state.missing:
            parts.note(f"Still missing, so nothing is saved: {state.missing}.", "doubt")

    missing = ui.refreshable(say)
    missing()
    state.changed += [state.refresh, missing.refresh]


def _time(state: Form) -> None:
    given = state.data.get("time", {})
    with ui.row().classes("items-center w-full"):
        column = ui.select(
            _with(state.names, given.get("column")), value=given.get("column"),
            label="Time column", clearable=True,
        ).classes("grow time")  # fmt: skip
        unit = ui.select(
            _with(TIME_UNITS, given.get("unit", "s")), value=given.get("unit", "s"), label="Unit",
            new_value_mode="add-unique", with_input=True,
        ).classes("w-32")  # fmt: skip
        rate = ui.input("or samples a second", value=typed(given.get("rate")))
        rate.classes("w-48")

    def take() -> None:
        each = parts.number(rate.value, "samples a second", such="such as 1000")
        state.take(with_time(state.data, column.value, unit.value, each))

    column.on_value_change(take)
    unit.on_value_change(take)
    parts.on_leaving(rate, lambda _: take())


def _row(state: Form, quantity: Quantity, drive: int, name: str, entry: Data) -> None:
    def label(of: str) -> str:
        return f'stack-label label="{of}" aria-label="{quantity} of {name}: {of}"'

    def setter(key: str) -> Callable[[Any], None]:
        return lambda event: state.set(quantity, drive, key, event.value)

    def number(key: str, text: str) -> None:
        where = f"{quantity} of {name}: {_NUMBERS[key]}"
        state.set(quantity, drive, key, parts.number(text, where, DEFAULTS[key]))

    ui.label(name).classes("drive")
    fields: dict[str, ValueElement[Any]] = {
        "column": ui.select(
            _with(state.names, entry.get("column")), value=entry.get("column"), with_input=True,
            clearable=True, on_change=setter("column"),
        ).props(label("column")).classes("of"),
        "unit": ui.select(
            _with(UNITS[quantity], entry.get("unit")), value=entry.get("unit"),
            new_value_mode="add-unique", with_input=True, on_change=setter("unit"),
        ).props(label("unit")),
        "sign": ui.select(
            {1: "+", -1: "−"}, value=entry.get("sign", 1), on_change=setter("sign")
        ).props(label("sign")),
    }  # fmt: skip
    for key, shown in _NUMBERS.items():
        if key == "torque_constant" and quantity != "torque":
            ui.label("")
            continue
        field = ui.input(value=typed(entry.get(key, DEFAULTS[key]))).props(label(shown))
        parts.on_leaving(field, partial(number, key))
        fields[key] = field
    state.fields |= {(quantity, drive, key): field for key, field in fields.items()}


def _with(choices: Sequence[str], own: str | None) -> list[str]:
    """Columns or units to choose from, including the file's own."""
    return [*choices, *([own] if own and own not in choices else [])]
