"""Stage 6, use of the model: motions, simulation, forces, exports, and files to download."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, get_args

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from deltaid.control.options import ControllerName
from deltaid.exports.options import FURTHER, FmiVersion
from deltaid.studio.pages import parts
from deltaid.studio.runs import MESSAGES, OUTPUT, RECORD, FinishedRun, describe_fit, runs, text_of
from deltaid.studio.session import Session
from deltaid.studio.steps import (
    AlongKind,
    Kind,
    Step,
    along_step,
    excite_step,
    export_step,
    insisting,
)
from deltaid.studio.words import INSIST

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
# Groups of options that each export target has.
_CHOICES_OF = {"c": ("code",), "st": ("code",), "fmu": ("unit",), "fmu-inverse": ("unit",)}
# Key of the user's choice to use a poor model.
_POOR = "use poor"
_FRICTION = {
    "all": "as identified",
    "plain": "nearest viscous and Coulomb friction",
    "none": "without friction",
}


async def body(session: Session) -> None:
    fitted, done = session.plan.model, runs(session.folder)
    model = fitted if fitted is not None and session.folder.has(fitted) else session.plan.robot
    if model is None:
        parts.note("Pick a robot first; a fitted model is better.")
        return
    if fitted is None:
        parts.note("There is no fitted model yet: what is here goes by the robot's prior.", "doubt")
    else:
        _model(session, model)
    planned = (r.file("motion.csv") for r in done if r.kind == "excite" and r.succeeded)
    motions = [name for name in planned if session.folder.has(name)]
    motions += [recording.file for recording in session.plan.recordings]
    _excite(session, model)
    _along(session, "torque", "Feed-forward: torques along a motion", model, motions)
    _along(session, "simulate", "Simulate a controller", model, motions)
    _along(session, "forces", "Forces in struts, joints and bearings", model, motions)
    _export(session, model)
    with parts.panel("Files of the folder"), ui.row():
        first = [fitted] if fitted and session.folder.has(fitted) else []
        for name in [*first, *(path.name for path in session.folder.files())]:
            ui.link(name, f"/files/{name}?download=true")


def _model(session: Session, model: str) -> None:
    name = session.plan.names.get(model.rpartition("/")[0], "")
    run = next((r for r in runs(session.folder) if r.file("model.yaml") == model), None)
    with parts.panel():
        ui.label(f"Everything here is made with {model}{f' ({name})' if name else ''}.")
        for sentence, kind in describe_fit(session.folder, run) if run else ():
            if kind == "bad":
                parts.note(sentence, kind)
                parts.remembered(session, _POOR, ui.switch(INSIST, value=False)).on_value_change(
                    lambda: session.store.redraw()
                )
        with ui.row():
            ui.button(
                "Download the model", on_click=lambda: ui.download(f"/files/{model}?download=true")
            ).props("outline")


def _step(
    session: Session, row: ui.row, kind: Kind, label: str,
    fields: Mapping[str, ValueElement[Any]], make: Callable[[str], Step],
) -> None:  # fmt: skip
    """A step with the model; the fields of its row keep their values by their names."""
    for name, field in fields.items():
        parts.remembered(session, f"{kind} {name}", field)

    def chosen(at: str) -> Step:
        insists = kind != "excite" and session.choices.get(_POOR)
        return insisting(make(at)) if insists else make(at)

    parts.step(
        session, kind, label, chosen, *fields.values(), row=row, below=partial(_downloads, session)
    )


def _downloads(session: Session, run: FinishedRun) -> None:
    if said := text_of(session.folder, run, MESSAGES).strip():
        parts.note(said, "doubt" if "warning:" in said else "")
    files = sorted((session.folder.root / run.folder).iterdir())
    with ui.row():
        ui.label(f"{run.name}:").classes("dim")
        for path in files:
            if path.is_file() and path.name not in (RECORD, MESSAGES, OUTPUT):
                ui.link(path.name, f"/files/{run.file(path.name)}", new_tab=True)
    for path in files:
        if path.name.startswith("README_"):
            with ui.expansion("README of this folder").classes("w-full").props("dense"):
                parts.code(session.folder.text(run.file(path.name)), "Copy README")


def _excite(session: Session, model: str) -> None:
    def make(at: str) -> Step:
        seconds, starts = float(duration.value or 10), int(count.value or 4)
        return excite_step(model, f"{at}/motion.csv", at, duration=seconds, starts=starts)

    with parts.panel("A motion for the next recording"):
        with ui.row().classes("items-center") as row:
            duration = ui.number("Seconds", value=10, min=0.1, max=3600)
            count = ui.number("Starts", value=4, min=1, max=100)
        _step(session, row, "excite", "Excite", {"seconds": duration, "starts": count}, make)


def _along(
    session: Session,
    kind: AlongKind,
    title: str,
    model: str,
    motions: list[str],
) -> None:
    used = {recording.file: recording.mapping for recording in session.plan.recordings}

    def make(at: str) -> Step:
        path = str(motion.value)
        return along_step(kind, model, path, used.get(path), at, option.value)

    with parts.panel(title):
        if not motions:
            parts.note("There is no motion yet: take one from above, or add a recording.")
            return
        with ui.row().classes("items-center") as row:
            motion = ui.select(motions, value=motions[0], label="Motion")
            motion.props(f'aria-label="Motion: {kind}"')
            if kind == "torque":
                option = ui.checkbox("The motion goes on as it begins (periodic)")
            elif kind == "simulate":
                option = ui.select(
                    list(get_args(ControllerName)), value="computed-torque", label="Controller"
                )
            else:
                option = ui.number("Distance of a limb's struts [m], if not described")
                option.classes("w-96")
        label = "Feed-forward" if kind == "torque" else kind.capitalize()
        _step(session, row, kind, label, {"motion": motion, "option": option}, make)


def _export(session: Session, model: str) -> None:
    def make(at: str) -> Step:
        to, of = str(form.value), _CHOICES_OF.get(str(form.value), ())
        return export_step(
            model, to, f"{at}/",
            plain_friction=friction.value == "plain", without_friction=friction.value == "none",
            functions=(further.value or ()) if "code" in of else (),
            single=bool(single.value) and "code" in of,
            fmi=str(fmi.value) if "unit" in of else "2",
        )  # fmt: skip

    with parts.panel("Export"):
        with ui.row().classes("items-center") as row:
            form = ui.select(_FORMS, value="mjcf", label="Form")
            friction = ui.select(_FRICTION, value="all", label="Friction")
            further = ui.select(list(FURTHER), value=[], label="Further functions", multiple=True)
            further.props("use-chips").classes("w-60")
            single = ui.checkbox("Single precision").props("dense")
            fmi = ui.select(list(get_args(FmiVersion)), value="2", label="FMI")
            fmi.classes("w-24")
        for choice, field in (("code", further), ("code", single), ("unit", fmi)):
            field.bind_visibility_from(
                form, "value", backward=lambda to, choice=choice: choice in _CHOICES_OF.get(to, ())
            )
        fields = {
            "form": form, "friction": friction, "further": further, "single": single, "fmi": fmi
        }  # fmt: skip
        _step(session, row, "export", "Export", fields, make)
