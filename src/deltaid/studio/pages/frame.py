"""The frame of all stages: header, stepper, content that follows the folder, files."""

from functools import partial

from nicegui import app, ui
from nicegui.client import Client
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response

from deltaid.studio.pages import check, fit, parts, recording, result, robot, use
from deltaid.studio.session import STAGES, Session, stage_states
from deltaid.view.html import part
from deltaid.view.own_page import POLL

_TITLES = {
    "robot": ("Robot", "Which machine is it?"),
    "recording": ("Recording", "What was recorded, and which column is what?"),
    "check": ("Check", "Is anything wrong with them?"),
    "fit": ("Fit", "Which masses, inertias and friction explain the torques?"),
    "result": ("Result", "How good is the model, and what was found?"),
    "use": ("Use", "Put the model to work."),
}
_MARKS = {"done": "check_circle", "wrong": "error", "open": "radio_button_unchecked", "later": ""}
_WORDS = {"done": "done", "wrong": "to fix", "open": "open", "later": "later"}
_BODIES = dict(zip(STAGES, (robot, recording, check, fit, result, use), strict=True))
# Themes: label of the button, the next theme, and the JavaScript to set it.
_THEMES: dict[bool | None, tuple[str, bool | None, str]] = {
    None: ("Theme: system", True, "studioTheme(null)"),
    True: ("Theme: dark", False, "studioTheme(true)"),
    False: ("Theme: light", None, "studioTheme(false)"),
}
# Pages in the folder may contain anything, so they have no access to the studio.
_OF_FILES = "sandbox allow-scripts allow-downloads; default-src 'unsafe-inline' data: blob:"


def build(session: Session) -> None:
    """Add all pages and routes, and the style of their parts."""
    ui.button.default_props("no-caps")
    for field in (ui.select, ui.input, ui.number):
        field.default_props("outlined dense")
    for stage in STAGES:
        title = f"{_TITLES[stage][0]} · deltaid studio"
        ui.page(f"/{stage}", title=title)(partial(_stage, session, stage))

    @app.get("/")
    def _first() -> Response:
        states = stage_states(session)
        stage = next((s for s in STAGES if states[s] in ("open", "wrong")), STAGES[0])
        return RedirectResponse(f"/{stage}", status_code=303)

    @app.get("/files/{name:path}")
    def _file(name: str, download: bool = False) -> Response:
        if not session.folder.has(name):
            return PlainTextResponse("no such file\n", status_code=404)
        path = session.folder.path(name)
        headers = {"Content-Security-Policy": _OF_FILES, "Cache-Control": "no-cache"}
        kind = "inline" if path.suffix == ".html" and not download else "attachment"
        return FileResponse(
            path, headers=headers, filename=path.name, content_disposition_type=kind
        )


def _stage(session: Session, stage: str, client: Client) -> None:
    ui.add_css(part("studio.css", "studio/pages"))
    ui.add_body_html(f"<script>{part('studio.js', 'studio/pages')}</script>")
    ui.colors(primary="#1f5fa8", positive="#2c7a4b", negative="#b3261e", warning="#8a6100")
    _header(session)
    nav = ui.refreshable(lambda: _stepper(session, stage))
    title, question = _TITLES[stage]
    nav()
    with ui.element("main").classes("stage").props("id=main"):
        with ui.element("h1").classes("title"):
            ui.label(title)
        ui.label(question).classes("question")
        content = ui.column().classes("body")
        _arrows(stage)
    drawn: int | None = None

    async def draw() -> None:
        """Redraw after changes, unless the form that made them shows them already."""
        nonlocal drawn
        changes = session.store.changes
        by_others = drawn is None or any(by != client.id for by in changes[drawn:])
        if drawn == len(changes):
            return
        drawn = len(changes)
        nav.refresh()
        if by_others:
            content.clear()
            with content, parts.showing_errors():
                session.folder.require()
                await _BODIES[stage].body(session)

    client.on_exception(parts.warn)
    ui.timer(POLL, session.store.look)
    # A timer calls its function again only once that has returned, so no content is drawn twice.
    ui.timer(parts.REDRAW, draw)


def _header(session: Session) -> None:
    with ui.header().classes("top"):
        ui.link("Skip to content", "#main").classes("skip")
        ui.label("deltaid studio").classes("brand")
        ui.label(str(session.folder.root)).classes("folder").tooltip("All files lie here")
        dark = ui.dark_mode(session.dark)

        def turn() -> None:
            session.dark = _THEMES[session.dark][1]
            text, _, script = _THEMES[session.dark]
            dark.set_value(session.dark)
            button.set_text(text)
            ui.run_javascript(script)

        button = ui.button(_THEMES[session.dark][0], on_click=turn)
        button.props("flat dense color=white")
    ui.add_body_html(f"<script>{_THEMES[session.dark][2]}</script>")


def _stepper(session: Session, here: str) -> None:
    states = stage_states(session)
    with ui.element("nav").classes("steps").props('aria-label="Stages"'):
        for number, stage in enumerate(STAGES, 1):
            state = states[stage]
            with ui.link(target=f"/{stage}").classes(f"step {state}") as link:
                if stage == here:
                    link.classes("here").props('aria-current="step"')
                link.props(f'aria-label="{number} {_TITLES[stage][0]}, {_WORDS[state]}"')
                if _MARKS[state]:
                    ui.icon(_MARKS[state]).props('aria-hidden="true"')
                else:
                    ui.label(str(number)).classes("number")
                ui.label(_TITLES[stage][0]).classes("name")


def _arrows(stage: str) -> None:
    place = STAGES.index(stage)
    with ui.row().classes("ways"):
        for before in STAGES[:place][-1:]:
            parts.go_to(before, f"← {_TITLES[before][0]}", "flat")
        ui.space()
        for after in STAGES[place + 1 :][:1]:
            parts.go_to(after, f"{_TITLES[after][0]} →")
