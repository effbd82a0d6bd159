"""Stage 5: results. What was found, its report, and runs side by side."""

from typing import Any

from nicegui import ui

from deltaid.studio.compare import comparison, told_of
from deltaid.studio.look import Problem
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import beside
from deltaid.studio.plan import Used
from deltaid.studio.runs import Run, runs
from deltaid.studio.session import Session, fit_runs, mapping_of
from deltaid.studio.steps import validate_step
from deltaid.studio.torques import torques


async def body(session: Session) -> None:
    """The whole stage."""
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
    await _compare(session, models)
    _validate(session, chosen)
    _history(session, everything, chosen)


def _shown(session: Session, run: Run) -> None:
    with parts.panel(f"{run.name}: {session.plan.names.get(run.folder, 'the model')}"):
        for sentence, kind in told_of(session.folder, run):
            parts.note(sentence, kind)
        parts.report(session, run.file("report.html"), f"Report of {run.name}")
        _commands(run)


def _commands(run: Run) -> None:
    with ui.expansion("Command line and Python of this run").classes("w-full").props("dense"):
        parts.code(run.record.command, "Copy command", "command")
        parts.code(run.record.python, "Copy Python", "python")


async def _compare(session: Session, models: list[Run]) -> None:
    if len(models) < 2:
        return
    recordings = {one.file: one for one in session.plan.recordings if session.folder.has(one.file)}
    with parts.panel("Side by side"):
        names = {run.folder: run.name for run in models}

        async def draw() -> None:
            pair = [run for key in (left.value, right.value) for run in models if run.folder == key]
            place.clear()
            with place:
                parts.table(("", *(run.name for run in pair)), comparison(session.folder, pair))
                await _over_time(session, pair, recordings.get(str(along.value)))

        with ui.row().classes("items-center"):
            left = ui.select(names, value=models[1].folder, label="Left").props("outlined dense")
            right = ui.select(names, value=models[0].folder, label="Right").props("outlined dense")
            along = ui.select(list(recordings), value=next(iter(recordings), None), label="Along")
            along.props("outlined dense")
            ui.button("Compare", on_click=draw).props("outline no-caps")
        place = ui.column().classes("w-full")


async def _over_time(session: Session, pair: list[Run], used: Used | None) -> None:
    """Torques of both models along a recording, on one time axis."""
    if used is None:
        return
    waiting = ui.spinner()
    path, mapping = str(session.folder.path(used.file)), mapping_of(session, used)
    models = [str(session.folder.path(run.file("model.yaml"))) for run in pair]
    found = await session.look(torques, path, mapping, models)
    waiting.delete()
    if isinstance(found, Problem):
        parts.problem(found)
        return
    plot = ui.plotly(beside(found, [run.name for run in pair])).classes("w-full")
    plot.props(f'role=img aria-label="Torques of both models along {used.file}"')


def _validate(session: Session, run: Run) -> None:
    """A model beside any recording of the folder."""
    known = {one.file: one for one in session.plan.recordings}
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
    rows = [(one.file, one.sha256[:16]) for one in record.inputs]
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
