"""Parts of several stages: errors with their fixes, commands to copy, progress, reports, files."""

from collections.abc import Awaitable, Callable, Generator, Sequence
from contextlib import contextmanager, nullcontext
from html import escape
from typing import Any, TypeVar

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from deltaid.errors import DeltaidError
from deltaid.studio.plan import Used
from deltaid.studio.runs import FinishedRun, next_run
from deltaid.studio.session import Session, unmapped
from deltaid.studio.steps import Kind, Step
from deltaid.studio.words import page_words

_Field = TypeVar("_Field", bound=ValueElement[Any])

# Period at which pages look for changes, too short to be noticed [s].
REDRAW = 0.1


@contextmanager
def panel(title: str = "") -> Generator[None, None, None]:
    """A part of a stage with a heading; it shows errors of its content."""
    with ui.element("section").classes("panel"):
        if title:
            with ui.element("h2"):
                ui.label(title)
        with showing_errors():
            yield


@contextmanager
def showing_errors() -> Generator[None, None, None]:
    """Show errors raised inside in place: what, where, and the fix."""
    try:
        yield
    except DeltaidError as error:
        problem(error)


def note(text: str, kind: str = "", cure: str = "") -> None:
    """A permanent remark with its fix; kind is '', 'good', 'doubt' or 'bad'."""
    role = "alert" if kind == "bad" else "note"
    with ui.element("div").classes(f"note {kind}").props(f"role={role}"):
        ui.label(page_words(text))
        if cure:
            ui.label(f"→ {page_words(cure)}").classes("cure")


def redrawn(draw: Callable[[], Awaitable[None]]) -> Callable[[], Awaitable[None]]:
    """A place for the content that a function draws; calling the returned function draws it
    again."""
    place = ui.column().classes("w-full")

    async def again() -> None:
        place.clear()
        with place, showing_errors():
            await draw()

    return again


def problem(error: DeltaidError) -> None:
    """Show an error: what is wrong, where, and the fix."""
    what, cure = _words(error)
    note(what, "bad", cure)


def warn(error: Exception) -> None:
    """Show an error as a temporary message; a defect goes into the server's log."""
    if isinstance(error, DeltaidError):
        ui.notify(" → ".join(filter(None, _words(error))), type="negative", multi_line=True,
                  timeout=20_000, close_button="Close")  # fmt: skip


def _words(error: DeltaidError) -> tuple[str, str]:
    where = page_words(error.where)
    return page_words(f"{where}: {error.what}" if where else error.what), page_words(error.cure)


def number(
    text: object, key: str, default: Any = None, such: str = "such as 1.5, with a point"
) -> Any:
    """The number in a field, or the default if it is empty.

    Raises:
        DeltaidError: the text is no number.
    """
    if not str(text or "").strip():
        return default
    try:
        return float(str(text))
    except ValueError:
        raise DeltaidError(f"'{text}' is no number", where=key, cure=such) from None


def on_leaving(field: ui.input, take: Callable[[str], None]) -> None:
    """Accept the text when the user leaves the field or presses Enter."""
    before = field.value

    def do() -> None:
        nonlocal before
        if field.value != before:
            before = field.value
            take(str(field.value))

    for event in ("blur", "keydown.enter"):
        field.on(event, do)


@contextmanager
def waiting() -> Generator[None, None, None]:
    """Show an indicator while the block runs."""
    sign = ui.spinner().props('aria-label="reading"')
    try:
        yield
    finally:
        if not sign.is_deleted:
            sign.delete()


def change(session: Session, **values: object) -> None:
    session.store.change(lambda plan: plan.changed(**values))


def change_use(session: Session, used: Used, **values: object) -> None:
    session.store.change(lambda plan: plan.with_recording(used.changed(**values)))


def go_to(stage: str, label: str, looks: str = "outline") -> None:
    ui.button(label, on_click=lambda: ui.navigate.to(f"/{stage}")).props(looks)


def remembered(session: Session, key: str, field: _Field) -> _Field:
    """The field, which keeps its value when the page is redrawn."""
    value = session.choices.get(key)
    known = getattr(field, "options", None)
    wanted = value if isinstance(value, list) else [value]
    if value is not None and (known is None or all(each in known for each in wanted)):
        field.set_value(value)
    field.on_value_change(lambda event: session.choices.update({key: event.value}))
    return field


def all_mapped(session: Session) -> bool:
    """Whether all recordings in use are mapped; shows those that are not."""
    missing = unmapped(session)
    gone = ", ".join(name for name in missing if not session.folder.has(name))
    if gone:
        note(f"{gone}: no longer in the folder. Put it back, or forget it.", "bad")
    elif missing:
        note(f"Say first which column is what in {', '.join(missing)}.", "doubt")
    if missing:
        go_to("recording", "Go to the recordings")
    return not missing


def progress(session: Session, kind: str) -> None:
    """Progress of the running step of this kind, if any, with a button to cancel it."""
    job = session.job
    if job is None or job.step.kind != kind:
        return
    if job.state == "cancelled":
        note("Cancelled: nothing was written.", "doubt")
    if job.state == "failed":
        what, _, cure = job.error.partition("\n  → ")
        note(what, "bad", cure)
    if job.state != "running":
        return
    with ui.element("div").classes("note").props("role=status aria-live=polite"):
        with ui.row().classes("items-center w-full no-wrap"):
            ui.spinner(size="22px").props('aria-hidden="true"')
            stage = ui.label().classes("grow")
            seconds = ui.label().classes("dim")
            ui.button("Cancel", on_click=job.cancel).props("outline color=negative")
        before = ui.label().classes("dim")

    def tick() -> None:
        stage.set_text(job.stages[-1] if job.stages else "starting")
        before.set_text(" · ".join(job.stages[-5:-1]))
        seconds.set_text(f"{job.seconds:.0f} s")

    tick()
    ui.timer(0.3, tick)


def report(session: Session, name: str, label: str) -> None:
    """A page of the folder, embedded in this one."""
    if not session.folder.has(name):
        return
    stamp = session.folder.path(name).stat().st_mtime_ns
    theme = {None: "", True: "&theme=dark", False: "&theme=light"}[session.dark]
    ui.element("iframe").classes("frame").props(
        f'src="/files/{name}?v={stamp}{theme}" title="{escape(label)}" loading=lazy'
    )
    with ui.row():
        ui.link("Open in a tab of its own", f"/files/{name}", new_tab=True)
        ui.link("Download", f"/files/{name}?download=true")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A plain table that scrolls if it is too wide."""
    head = "".join(f"<th scope=col>{escape(title)}</th>" for title in columns)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    text = f'<div class="wide"><table class="plain"><thead><tr>{head}</tr></thead><tbody>{lines}'
    ui.html(f"{text}</tbody></table></div>", sanitize=False).classes("w-full")


def step(
    session: Session,
    kind: Kind,
    label: str,
    make: Callable[[str], Step],
    *fields: ValueElement[Any],
    row: ui.row | None = None,
    ready: bool = True,
    looks: str = "outline",
    below: Callable[[FinishedRun], None] = lambda run: None,
) -> None:
    """A button that begins a step, its progress, the result of the last one, and its command.

    Args:
        make: makes the step for a run's folder.
        fields: that the step depends on.
        row: where the button is placed.
        ready: whether it may begin if no other one runs.
        below: shows the last run.
    """
    with row or nullcontext():
        ui.button(label, on_click=lambda: session.begin(kind, make)).props(looks).set_enabled(
            ready and not session.busy
        )
    progress(session, kind)
    if (run := session.last(kind)) is not None:
        below(run)
    at = next_run(session.folder, kind)
    commands(lambda: make(at), *fields)


def commands(make: Callable[[], Step], *fields: ValueElement[Any]) -> None:
    """The command line of a step and the equivalent Python, for copying.

    Args:
        make: makes the step as it would begin now.
        fields: that it depends on; when one changes, the text is updated.
    """

    def text() -> None:
        ui.label("In the studio's folder:").classes("dim")
        command_and_python(make())

    whole = ui.expansion("Command line and Python of this step").classes("w-full").props("dense")
    with whole:
        shown = ui.refreshable(text)
        shown()
    for field in (whole, *fields):
        field.on_value_change(lambda: shown.refresh())


def command_and_python(step: Step | FinishedRun) -> None:
    code(step.command, "Copy command", "command")
    code(step.python, "Copy Python", "python")


def code(text: str, label: str, kind: str = "") -> None:
    """Text with a button that copies it."""
    ui.html(f'<pre class="code {kind}" tabindex="0">{escape(text)}</pre>', sanitize=False).classes(
        "w-full"
    )
    ui.button(label, on_click=lambda: ui.clipboard.write(text)).props("flat dense")


def difference(text: str) -> None:
    """A unified diff with coloured lines."""
    marks = {"+": "plus", "-": "minus"}
    body = "\n".join(
        f'<span class="{marks.get(line[:1], "")}">{escape(line)}</span>'
        for line in text.splitlines()
    )
    ui.html(f'<div class="diff" tabindex="0">{body}</div>', sanitize=False).classes("w-full")
