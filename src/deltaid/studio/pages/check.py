"""Stage 3, the check: verdicts, and proposed changes that are written after their diff."""

from functools import partial
from typing import Any

from nicegui import ui

from deltaid.checks.verdicts import robot_text
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, catalogue_text, described_in
from deltaid.studio.edits import difference, proposed_changes
from deltaid.studio.look import mapping_cured
from deltaid.studio.pages import parts
from deltaid.studio.plan import Plan, Used
from deltaid.studio.runs import FinishedRun, output
from deltaid.studio.session import Session, mapping_name, mapping_of
from deltaid.studio.steps import check_step
from deltaid.studio.words import page_words

_ORDER = [*reversed(Grade)]
_SENTENCES = {
    "good": "All is good.",
    "cannot tell": "Nothing is wrong; something is undecided.",
    "doubtful": "Nothing is wrong, but something is doubtful.",
    "wrong": "Something is wrong: correct it before you fit.",
}


async def body(session: Session) -> None:
    if not isinstance(session.robot(), RobotDescription):
        parts.note("Pick a robot first; its description is checked even without a recording.")
        return
    plan, last, seen = session.plan, session.last("check"), bool(session.grade())
    with parts.panel():
        names = ", ".join(recording.file for recording in plan.used)
        ui.label(f"Of {plan.robot}{f' with {names}' if names else ', the description only'}")
        ready = parts.all_mapped(session)
        if last is not None and not seen and not session.busy:
            parts.note(
                "Robot, recordings, mapping or filter have changed since the last check: "
                "check again.",
                "doubt",
            )
        parts.step(session, "check", "Check", partial(check_step, plan), ready=ready, looks="")
    if last is not None and not session.busy:
        _verdicts(session, last, seen)


def _verdicts(session: Session, run: FinishedRun, seen: bool) -> None:
    result = output(session.folder, run)
    grade = str(result.get("grade", ""))
    verdicts: list[dict[str, Any]] = result.get("verdicts", [])
    parts.note(_SENTENCES.get(grade, grade), {"wrong": "bad", "good": "good"}.get(grade, "doubt"))
    if not seen:
        ui.label("These verdicts are of what was there before the last change.").classes("dim")
    verdicts = sorted(verdicts, key=lambda verdict: _ORDER.index(verdict["grade"]))
    good = [verdict for verdict in verdicts if verdict["grade"] == "good"]
    for verdict in verdicts[: len(verdicts) - len(good)]:
        _card(session, verdict)
    if good:
        with ui.expansion(f"{len(good)} checks found nothing").classes("w-full"):
            for verdict in good:
                _words(verdict)
    ui.link("The same as a page", f"/files/{run.file('check.html')}", new_tab=True)


def _words(verdict: dict[str, Any]) -> None:
    with ui.row().classes("items-center"):
        ui.label(verdict["grade"]).classes(f"grade {verdict['grade'].rpartition(' ')[2]}")
        ui.label(verdict["key"]).classes("text-weight-bold")
    about = "" if verdict["subject"] in verdict["seen"] else f"{verdict['subject']}: "
    ui.label(page_words(f"{about}{verdict['seen']}"))


def _card(session: Session, verdict: dict[str, Any]) -> None:
    with parts.panel():
        _words(verdict)
        for mark, key in (("Likely:", "cause"), ("→", "cure")):
            if verdict[key]:
                ui.label(page_words(f"{mark} {verdict[key]}"))
        if verdict["key"] == "torque-lag":
            ui.label("The fit corrects this lag too (setting: Lag).").classes("dim")
        for file, name in (("robot", "the robot file"), ("mapping", "the mapping")):
            if changes := proposed_changes(verdict, file):
                label = f"Show the change to {name}"
                ui.button(label, on_click=partial(_offer, session, verdict, file, changes)).props(
                    f'outline aria-label="{label} for {verdict["key"]}"'
                )


async def _offer(
    session: Session, verdict: dict[str, Any], file: str, changes: list[tuple[str, object]]
) -> None:
    folder, plan, robot = session.folder, session.plan, session.plan.robot or ""
    used = None if file == "robot" else _used(plan, verdict)
    if used is not None:
        name = used.mapping or mapping_name(session, used.file)
        before = folder.text(name)
        path, mapping = str(folder.path(used.file)), mapping_of(session, used)
        after = await session.read_cached(
            mapping_cured, path, session.place(robot), mapping, changes
        )
    else:
        name = folder.free_name(f"{robot}.yaml") if robot in catalogue() else robot
        before = catalogue_text(robot) if robot in catalogue() else folder.text(robot)
        with folder.called_by_name():
            after = robot_text(session.place(robot), dict(changes))
        described_in(after, name)  # raises if the changes do not fit
    instead_of = before if folder.has(name) else None

    def write() -> None:
        dialog.close()
        folder.write(name, after, instead_of=instead_of)
        if used is None:
            parts.change(session, robot=name)
        else:
            parts.change_use(session, used, mapping=name)
        ui.notify(f"{name} is changed", type="positive")

    with ui.dialog(value=True) as dialog, ui.card().style("min-width: min(640px, 90vw)"):
        ui.label(f"Change {name}?").classes("text-h6")
        parts.difference(difference(name, before, after))
        with ui.row():
            ui.button("Apply", on_click=write).props("autofocus")
            ui.button("Leave it", on_click=dialog.close).props("flat")


def _used(plan: Plan, verdict: dict[str, Any]) -> Used:
    """The recording of a verdict, which the subject names if there are several."""
    for recording in plan.used:
        if len(plan.used) == 1 or str(verdict["subject"]).startswith(recording.file):
            return recording
    raise DeltaidError(
        "is of no single recording", where=str(verdict["key"]), cure="change the mappings by hand"
    )
