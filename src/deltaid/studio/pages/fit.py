"""Stage 4: the fit. Settings with their defaults, progress, and an end before its end."""

from functools import partial
from typing import Any, get_args

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.model.options import (
    ComplianceChoice,
    EffectsChoice,
    FrictionLaws,
    IntervalChoice,
    Method,
    RegularizerName,
)
from deltaid.model.record import Settings
from deltaid.studio.pages import parts
from deltaid.studio.session import Session
from deltaid.studio.steps import fit_step
from deltaid.studio.words import INSIST

_CHOICES: dict[str, tuple[str, Any]] = {
    "friction": ("Friction laws: choose further terms, or as described", FrictionLaws),
    "intervals": ("Intervals of parameters", IntervalChoice),
    "method": ("Method", Method),
    "regularizer": ("Distance to the prior", RegularizerName),
    "compliance": ("Gears that wind up", ComplianceChoice),
    "effects": (
        "Zeros, lengths, tilt, forces and ripples that the recording asks for",
        EffectsChoice,
    ),
}
_NUMBERS = {
    "cutoff": "Cut-off of the low-pass [Hz]; empty: from the data",
    "gamma": "Weight γ of the prior; empty: from the noise",
    "prior_spread": "How far the prior may be off, as a share",
}
_SWITCHES = {
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
        insist = ui.switch(INSIST, value=plan.force)
        insist.on_value_change(lambda event: parts.change(session, force=bool(event.value)))
        return plan.force
    return True


def _settings(session: Session) -> None:
    settings = session.plan.settings

    def take(key: str, value: Any) -> None:
        session.store.change(
            lambda plan: plan.changed(settings=plan.settings.changed(**{key: value}))
        )

    def number(key: str, text: str) -> None:
        take(key, parts.number(text, key, getattr(Settings(), key), "such as 30"))

    with parts.panel("Settings"):
        changed = settings != Settings()
        ui.label(
            "Changed from the defaults." if changed else "Defaults are right for most recordings."
        ).classes("dim")
        with ui.element("div").classes("columns"):
            for key, (label, kind) in _CHOICES.items():
                ui.select(
                    list(get_args(kind)),
                    value=getattr(settings, key),
                    label=label,
                    on_change=lambda event, key=key: take(key, event.value),
                )
            for key, label in _NUMBERS.items():
                value = getattr(settings, key)
                field = ui.input(label, value="" if value is None else f"{value:.10g}")
                parts.on_leaving(field, partial(number, key))
            given = settings.lag
            shown = given if isinstance(given, str) else ",".join(f"{1e3 * s:.10g}" for s in given)
            lag = ui.input("Lag of torques: estimate, none, or ms", value=shown)
            parts.on_leaving(lag, lambda text: take("lag", _lag(text)))
            for key, label in _SWITCHES.items():
                ui.switch(
                    label,
                    value=getattr(settings, key),
                    on_change=lambda event, key=key: take(key, event.value),
                )
        if changed:
            reset = partial(parts.change, session, settings=Settings())
            ui.button("Back to the defaults", on_click=reset).props("flat")


def _lag(text: str) -> Any:
    """What the option --lag would make of it."""
    if text.strip() in ("estimate", "none"):
        return text.strip()
    try:
        return tuple(1e-3 * float(number) for number in text.split(","))
    except ValueError:
        raise DeltaidError(
            f"'{text}' is no lag",
            where="lag",
            cure="write estimate, none, or ms such as 2 or 2,2,1",
        ) from None
