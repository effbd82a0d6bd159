"""Stage 4, the fit: settings with their defaults, progress, cancellation."""

from functools import partial
from typing import Any, Literal, get_args, get_origin

from nicegui import ui

from deltaid.model.options import lag_of
from deltaid.model.record import Settings
from deltaid.studio.pages import parts
from deltaid.studio.session import Session
from deltaid.studio.steps import fit_step, typed
from deltaid.studio.words import INSIST

# Settings in the page's order, with the labels of their fields.
_LABELS = {
    "friction": "Friction laws: choose further terms, or as described",
    "intervals": "Intervals of parameters",
    "method": "Method",
    "regularizer": "Distance to the prior",
    "compliance": "Gears that wind up",
    "effects": "Zeros, lengths, tilt, forces and ripples that the recording asks for",
    "cutoff": "Cut-off of the low-pass [Hz]; empty: from the data",
    "gamma": "Weight γ of the prior; empty: from the noise",
    "prior_spread": "How far the prior may be off, as a share",
    "lag": "Lag of torques: estimate, none, or ms",
    "events": "Detect contacts, stops and spikes, and exclude them",
    "keep_all": "Exclude nothing else (rest, brakes, reversals)",
}


async def body(session: Session) -> None:
    plan = session.plan
    if plan.robot is None or not plan.fitted:
        parts.note("Pick a robot and a recording first.")
        return
    with parts.panel():
        names = ", ".join(recording.file for recording in plan.fitted)
        tested = f", tested on {plan.verified.file}" if plan.verified else ""
        ui.label(f"{plan.robot} from {names}{tested}")
        if not plan.verified:
            ui.label(
                "A second recording of another motion, marked “test” under Recording, would show "
                "how well the model predicts unknown data."
            ).classes("dim")

        job, make = session.job, partial(fit_step, plan)
        parts.step(session, "fit", "Fit", make, ready=_gate(session), looks="")
        if job is not None and job.step.kind == "fit" and job.state == "done":
            parts.note("The model is fitted.", "good")
            parts.go_to("result", "See the result", "")
    _settings(session)


def _gate(session: Session) -> bool:
    plan = session.plan
    if not parts.all_mapped(session):
        return False
    if not (grade := session.grade()):
        again = (
            "has changed since the check" if session.last("check") else "has not been checked yet"
        )
        parts.note(f"What is to be fitted {again}: run the check first.", "doubt")
        parts.go_to("check", "Go to the check")
        return False
    if grade == "wrong":
        parts.note("The check calls something wrong, and a fit would refuse it.", "bad")
        ui.switch(INSIST, value=plan.force).on_value_change(
            lambda event: parts.change(session, force=bool(event.value))
        )
        return plan.force
    return True


def _settings(session: Session) -> None:
    settings = session.plan.settings

    def take(key: str, value: Any) -> None:
        session.store.change(
            lambda plan: plan.changed(settings=plan.settings.changed(**{key: value}))
        )

    def read(key: str, text: str) -> None:
        default = getattr(Settings(), key)
        take(key, lag_of(text) if key == "lag" else parts.number(text, key, default, "such as 30"))

    with parts.panel("Settings"):
        changed = settings != Settings()
        ui.label(
            "Changed from the defaults." if changed else "Defaults are right for most recordings."
        ).classes("dim")
        with ui.element("div").classes("columns"):
            for key, label in _LABELS.items():
                value, kind = getattr(settings, key), Settings.model_fields[key].annotation
                if kind is bool:
                    field = ui.switch(label, value=value)
                elif get_origin(kind) is Literal:
                    field = ui.select(list(get_args(kind)), value=value, label=label)
                else:
                    parts.on_leaving(ui.input(label, value=typed(value)), partial(read, key))
                    continue
                field.on_value_change(lambda event, key=key: take(key, event.value))
        if changed:
            ui.button(
                "Back to the defaults", on_click=partial(parts.change, session, settings=Settings())
            ).props("flat")
