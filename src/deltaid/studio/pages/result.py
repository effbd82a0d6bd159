"""Stage 5, results: a model, its report, and comparisons of runs."""

from functools import partial
from typing import Any

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.studio.look import TorqueCurves, torques
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import compared_curves, zoomable
from deltaid.studio.plan import Used
from deltaid.studio.runs import FinishedRun, comparison, describe_fit, runs
from deltaid.studio.session import Session, mapping_of
from deltaid.studio.steps import Step, validate_step
from deltaid.view.numbers import percent

_SHOWN = ["torques", "errors"]


async def body(session: Session) -> None:
    everything = runs(session.folder)
    models = [run for run in everything if run.kind == "fit" and run.succeeded]
    if not models:
        parts.note("There is no model yet: fit one first.")
        return
    chosen = next(
        (run for run in models if run.file("model.yaml") == session.plan.model), models[0]
    )
    with parts.panel(f"{chosen.name}: {session.plan.names.get(chosen.folder, 'the model')}"):
        for sentence, kind in describe_fit(session.folder, chosen):
            parts.note(sentence, kind)
        parts.report(session, chosen.file("report.html"), f"Report of {chosen.name}")
        _commands(chosen)
    _over_time(session, models, chosen)
    _validate(session, chosen)
    _history(session, everything, chosen)


def _commands(run: FinishedRun) -> None:
    with ui.expansion("Command line and Python of this run").classes("w-full").props("dense"):
        parts.command_and_python(run)


def _validate(session: Session, run: FinishedRun) -> None:
    known = {recording.file: recording for recording in session.plan.recordings}
    if not known:
        return

    def make(at: str) -> Step:
        used, keep = known[str(file.value)], session.plan.settings.keep_all
        return validate_step(run.file("model.yaml"), used, at, keep_all=keep)

    with parts.panel("Test this model on a recording"):
        with ui.row().classes("items-center") as row:
            file = ui.select(list(known), value=next(iter(known)), label="Recording")
        parts.step(session, "validate", "Test", make, file, row=row)


def _history(session: Session, everything: list[FinishedRun], chosen: FinishedRun) -> None:
    with parts.panel("All runs"):
        for run in everything:
            state = "" if run.succeeded else " · failed or cancelled"
            here = " · shown above" if run.folder == chosen.folder else ""
            name = session.plan.names.get(run.folder, "")
            when = f"{run.began.replace('T', ' ')[:16]} · {run.seconds:g} s"
            with ui.expansion().classes("w-full").props("dense") as line:
                with line.add_slot("header"):
                    ui.label(f"{run.name} {name} · {when}{state}{here}").classes("grow")
                _provenance(session, run)


def _provenance(session: Session, run: FinishedRun) -> None:
    rows = [(read.file, read.sha256[:16]) for read in run.inputs]
    parts.table(("made from", "SHA-256, first 16 digits"), [*rows, ("deltaid", run.version)])
    _commands(run)
    name = ui.input("Name of this run", value=session.plan.names.get(run.folder, ""))

    def call(text: str) -> None:
        names = session.plan.names | {run.folder: text}
        parts.change(session, names={key: text for key, text in names.items() if text})

    parts.on_leaving(name, call)
    with ui.row():
        for path in sorted((session.folder.root / run.folder).iterdir()):
            if path.is_file():
                ui.link(path.name, f"/files/{run.file(path.name)}", new_tab=True)
    if run.kind == "fit" and run.succeeded:
        ui.button(
            "Show and use this model",
            on_click=partial(parts.change, session, model=run.file("model.yaml")),
        ).props("outline")


def _over_time(session: Session, models: list[FinishedRun], chosen: FinishedRun) -> None:
    known = {used.file: used for used in session.plan.recordings if session.folder.has(used.file)}
    if not known:
        return
    verified = session.plan.verified
    first = verified.file if verified and verified.file in known else next(iter(known))
    names = {run.folder: _name(session, run) for run in models}
    with parts.panel("Over time, and side by side"):
        with ui.row().classes("items-center w-full"):
            picked = ui.select(names, value=[chosen.folder], label="Models", multiple=True)
            picked.props("use-chips").classes("grow")
            along = ui.select(list(known), value=first, label="Recording")
            shown = ui.toggle(_SHOWN, value=_SHOWN[0]).props('no-caps aria-label="What is shown"')
        parts.remembered(session, "models along", along)
        parts.remembered(session, "models shown", shown)

        async def draw() -> None:
            runs = [run for run in models if run.folder in (picked.value or [])]
            used = known.get(str(along.value))
            if not runs or not used:
                return
            await _along(session, runs, used, str(shown.value))
            if len(runs) > 1:
                title = "Settings, errors and parameters side by side"
                with ui.expansion(title).classes("w-full"):
                    parts.table(("", *(r.name for r in runs)), comparison(session.folder, runs))
            _everywhere(session, runs, known)

        again = parts.redrawn(draw)
        for field in (picked, along, shown):
            field.on_value_change(again)
        ui.timer(0.05, again, once=True)


def _name(session: Session, run: FinishedRun) -> str:
    given = session.plan.names.get(run.folder)
    return f"{run.name} {given}" if given else run.name


async def _look(
    session: Session, runs: list[FinishedRun], used: Used, span: Any = None
) -> TorqueCurves:
    path, mapping = str(session.folder.path(used.file)), mapping_of(session, used)
    models = tuple(str(session.folder.path(run.file("model.yaml"))) for run in runs)
    return await session.read_cached(torques, path, mapping, models, span)


async def _along(session: Session, runs: list[FinishedRun], used: Used, shown: str) -> None:
    names, place = [_name(session, run) for run in runs], ui.column().classes("w-full")
    compared = await zoomable(
        f"{shown.capitalize()} of models along {used.file}",
        partial(_look, session, runs, used),
        lambda compared: compared_curves(compared, names, shown),
    )
    errors = zip(names, compared.nrmse.tolist(), strict=True)
    rows = [(name, *map(percent, nrmse)) for name, nrmse in errors]
    with place:
        parts.table(("error, as a share of the torque", *compared.drives), rows)


def _everywhere(session: Session, runs: list[FinishedRun], known: dict[str, Used]) -> None:
    if len(known) < 2:
        return

    async def draw() -> None:
        with parts.waiting():
            rows = [(file, *await _shares(session, runs, used)) for file, used in known.items()]
        parts.table(("largest error of a drive", *(_name(session, run) for run in runs)), rows)

    ui.button("On every recording").props("outline dense").on_click(parts.redrawn(draw))


async def _shares(session: Session, runs: list[FinishedRun], used: Used) -> list[str]:
    try:
        shown = await _look(session, runs, used)
    except DeltaidError as error:
        return [error.what] * len(runs)
    return [percent(float(shares.max())) for shares in shown.nrmse]
