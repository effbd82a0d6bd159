"""Stage 5: results. What was found, its report, and runs side by side."""

from typing import Any

from nicegui import ui

from deltaid.studio.compare import describe_fit
from deltaid.studio.pages import parts
from deltaid.studio.pages.over_time import over_time
from deltaid.studio.plan import Used
from deltaid.studio.runs import Run, runs
from deltaid.studio.session import Session, fit_runs
from deltaid.studio.steps import validate_step


async def body(session: Session) -> None:
    """The model that was found, beside all other runs."""
    everything = runs(session.folder)
    models = fit_runs(everything)
    if not models:
        parts.note("There is no model yet: fit one first.")
        return
    parts.progress(session, "validate")
    chosen = next((run for run in models if run.file("model.yaml") == session.plan.model), None)
    if chosen is None:
        chosen = models[0]
    _shown(session, chosen)
    over_time(session, models, chosen)
    _validate(session, chosen)
    _history(session, everything, chosen)


def _shown(session: Session, run: Run) -> None:
    with parts.panel(f"{run.name}: {session.plan.names.get(run.folder, 'the model')}"):
        for sentence, kind in describe_fit(session.folder, run):
            parts.note(sentence, kind)
        parts.report(session, run.file("report.html"), f"Report of {run.name}")
        _commands(run)


def _commands(run: Run) -> None:
    with ui.expansion("Command line and Python of this run").classes("w-full").props("dense"):
        parts.code(run.record.command, "Copy command", "command")
        parts.code(run.record.python, "Copy Python", "python")


def _validate(session: Session, run: Run) -> None:
    """A model beside any recording of the folder."""
    known = {recording.file: recording for recording in session.plan.recordings}
    if not known:
        return
    with parts.panel("Test this model on a recording"), ui.row().classes("items-center"):
        file = ui.select(list(known), value=next(iter(known)), label="Recording")
        file.props("outlined dense")

        def begin() -> None:
            used: Used = known[str(file.value)]
            model = run.file("model.yaml")
            keep = session.plan.settings.keep_all
            parts.attempt(
                lambda: session.begin(
                    "validate", lambda at: validate_step(model, used, at, keep_all=keep)
                )
            )

        ui.button("Test", on_click=begin).props("outline no-caps").set_enabled(not session.busy)


def _history(session: Session, everything: list[Run], chosen: Run) -> None:
    with parts.panel("All runs"):
        for run in everything:
            with ui.expansion().classes("w-full").props("dense") as line:
                with line.add_slot("header"):
                    _line(session, run, chosen)
                _provenance(session, run)


def _line(session: Session, run: Run, chosen: Run) -> None:
    record = run.record
    state = "" if run.succeeded else " · failed or cancelled"
    here = " · shown above" if run.folder == chosen.folder else ""
    name = session.plan.names.get(run.folder, "")
    began = record.began.replace("T", " ")[:16]
    ui.label(f"{run.name} {name} · {began} · {record.seconds:g} s{state}{here}").classes("grow")


def _provenance(session: Session, run: Run) -> None:
    record = run.record
    rows = [(read.file, read.sha256[:16]) for read in record.inputs]
    parts.table(("made from", "SHA-256, first 16 digits"), [*rows, ("deltaid", record.version)])
    _commands(run)
    name = ui.input("Name of this run", value=session.plan.names.get(run.folder, ""))
    name.props("outlined dense")

    def call() -> None:
        names = {key: text for key, text in session.plan.names.items() if key != run.folder}
        if name.value:
            names[run.folder] = str(name.value)
        if names != session.plan.names:
            parts.attempt(lambda: session.store.change(lambda plan: plan.changed(names=names)))

    name.on("blur", call)
    name.on("keydown.enter", call)
    with ui.row():
        for file in sorted(path.name for path in (session.folder.root / run.folder).iterdir()):
            if (session.folder.root / run.folder / file).is_file():
                ui.link(file, f"/files/{run.file(file)}", new_tab=True)
    if run.record.kind == "fit" and run.succeeded:
        ui.button("Show and use this model", on_click=lambda: _use(session, run)).props(
            "outline no-caps"
        )


def _use(session: Session, run: Run) -> None:
    def edit(plan: Any) -> Any:
        return plan.changed(model=run.file("model.yaml"))

    parts.attempt(lambda: session.store.change(edit))
