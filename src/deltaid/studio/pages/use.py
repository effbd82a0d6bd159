"""Stage 6: the model at work. Motions, simulation, forces, exports, and files to download."""

from collections.abc import Callable
from typing import get_args

from nicegui import ui

from deltaid.control.options import ControllerName
from deltaid.studio.pages import parts
from deltaid.studio.runs import messages, next_run, runs
from deltaid.studio.session import Session
from deltaid.studio.steps import (
    Step,
    excite_step,
    export_step,
    forces_step,
    simulate_step,
    torque_step,
)

_FORMS = {
    "c": "C code (.c, .h)",
    "st": "Structured text for PLCs (.st)",
    "mjcf": "MuJoCo (MJCF)",
    "urdf": "URDF and loop closures",
    "fmu": "FMU, forward dynamics",
    "fmu-inverse": "FMU, inverse dynamics",
    "casadi": "CasADi function",
    "npz": "NumPy arrays (.npz)",
}


async def body(session: Session) -> None:
    """Everything that the model may be used for."""
    model = _subject(session)
    if model is None:
        parts.note("Pick a robot first; a fitted model is better.")
        return
    if session.plan.model is None:
        parts.note("There is no fitted model yet: what is here goes by the robot's prior.", "doubt")
    else:
        _model(session, model)
    motions = _motions(session)
    _excite(session, model)
    _along(session, "torque", "Feed-forward: torques along a motion", model, motions)
    _along(session, "simulate", "Simulate a controller", model, motions)
    _along(session, "forces", "Forces in struts, joints and bearings", model, motions)
    _export(session, model)
    _files(session)


def _subject(session: Session) -> str | None:
    model = session.plan.model
    return model if model is not None and session.folder.has(model) else session.plan.robot


def _model(session: Session, model: str) -> None:
    """Which model it is, and the file itself."""
    name = session.plan.names.get(model.rpartition("/")[0], "")
    with parts.panel():
        ui.label(f"Everything here is made with {model}{f' ({name})' if name else ''}.")
        with ui.row():
            ui.button(
                "Download the model", on_click=lambda: ui.download(f"/files/{model}?download=true")
            ).props("outline no-caps")


def _motions(session: Session) -> list[str]:
    """Files with a motion: planned ones first, then recordings."""
    planned = [
        name
        for run in runs(session.folder)
        if run.record.kind == "excite" and run.succeeded
        for name in (run.file("motion.csv"),)
        if session.folder.has(name)
    ]
    return [*planned, *(recording.file for recording in session.plan.recordings)]


def _begin(session: Session, kind: str, make: Callable[[str], Step]) -> None:
    parts.attempt(lambda: session.begin(kind, make))


def _last(session: Session, kind: str) -> None:
    """Progress of a step of this kind, and what the last one made."""
    parts.progress(session, kind)
    run = next((r for r in runs(session.folder) if r.record.kind == kind and r.succeeded), None)
    if run is None:
        return
    if said := messages(session.folder, run).strip():
        parts.note(said, "doubt" if "warning:" in said else "")
    with ui.row():
        ui.label(f"{run.name}:").classes("dim")
        for path in sorted((session.folder.root / run.folder).iterdir()):
            if path.is_file() and path.name not in ("run.yaml", "messages.txt", "output.json"):
                ui.link(path.name, f"/files/{run.file(path.name)}", new_tab=True)


def _excite(session: Session, model: str) -> None:
    def make(at: str) -> Step:
        seconds, starts = float(duration.value or 10), int(count.value or 4)
        return excite_step(model, f"{at}/motion.csv", at, duration=seconds, starts=starts)

    with parts.panel("A motion for the next recording"):
        with ui.row().classes("items-center"):
            duration = ui.number("Seconds", value=10, min=0.1, max=3600).props("outlined dense")
            count = ui.number("Starts", value=4, min=1, max=100).props("outlined dense")
            parts.remembered(session, "excite seconds", duration)
            parts.remembered(session, "excite starts", count)
            ui.button("Excite", on_click=lambda: _begin(session, "excite", make)).props(
                "outline no-caps"
            ).set_enabled(not session.busy)
        _last(session, "excite")
        parts.commands(lambda: make(next_run(session.folder, "excite")), duration, count)


def _along(session: Session, kind: str, title: str, model: str, motions: list[str]) -> None:
    """Feed-forward, simulation, or forces, along a motion."""
    with parts.panel(title):
        if not motions:
            parts.note("There is no motion yet: take one from above, or add a recording.")
            return
        used = {recording.file: recording.mapping for recording in session.plan.recordings}
        with ui.row().classes("items-center"):
            motion = ui.select(motions, value=motions[0], label="Motion").props("outlined dense")
            motion.props(f'aria-label="Motion: {kind}"')
            if kind == "torque":
                option = ui.checkbox("The motion goes on as it begins (periodic)")
            elif kind == "simulate":
                names = list(get_args(ControllerName))
                option = ui.select(names, value="computed-torque", label="Controller")
            else:
                option = ui.number("Distance of a limb's struts [m], if not described")
                option.classes("w-96")
            option.props("dense" if kind == "torque" else "outlined dense")
            parts.remembered(session, f"{kind} motion", motion)
            parts.remembered(session, f"{kind} option", option)

            def make(at: str) -> Step:
                path, asked = str(motion.value), option.value
                if kind == "torque":
                    return torque_step(model, path, used.get(path), at, periodic=bool(asked))
                if kind == "simulate":
                    return simulate_step(model, path, used.get(path), at, str(asked))
                return forces_step(model, path, used.get(path), at, asked)

            name = "Feed-forward" if kind == "torque" else kind.capitalize()
            ui.button(name, on_click=lambda: _begin(session, kind, make)).props(
                "outline no-caps"
            ).set_enabled(not session.busy)
        _last(session, kind)
        parts.commands(lambda: make(next_run(session.folder, kind)), motion, option)


def _export(session: Session, model: str) -> None:
    def make(at: str) -> Step:
        return export_step(model, str(form.value), f"{at}/", plain_friction=bool(plain.value))

    with parts.panel("Export"):
        with ui.row().classes("items-center"):
            form = ui.select(_FORMS, value="mjcf", label="Form").props("outlined dense")
            parts.remembered(session, "export form", form)
            plain = ui.checkbox("Nearest viscous and Coulomb friction").props("dense")
            parts.remembered(session, "export friction", plain)
            ui.button("Export", on_click=lambda: _begin(session, "export", make)).props(
                "outline no-caps"
            ).set_enabled(not session.busy)
        _last(session, "export")
        parts.commands(lambda: make(next_run(session.folder, "export")), form, plain)


def _files(session: Session) -> None:
    with parts.panel("Files of the folder"), ui.row():
        model = session.plan.model
        first = [model] if model and session.folder.has(model) else []
        for name in [*first, *(path.name for path in session.folder.files())]:
            ui.link(name, f"/files/{name}?download=true")
