"""Stage 3: the check. Verdicts, and cures that go into a file by a click, after their diff."""

from functools import partial
from typing import Any

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.robot.load import catalogue, catalogue_text
from deltaid.studio.edits import difference, own_copy, robot_cured, wanted
from deltaid.studio.look import Problem, mapping_cured
from deltaid.studio.pages import parts, texts
from deltaid.studio.plan import Used
from deltaid.studio.runs import FinishedRun, next_run, output, runs
from deltaid.studio.session import Session, mapping_name, mapping_of
from deltaid.studio.steps import check_step
from deltaid.studio.words import page_words

_ORDER = ("wrong", "doubtful", "cannot tell", "good")
_SENTENCES = {
    "good": "All is good.",
    "cannot tell": "Nothing is wrong; something is undecided.",
    "doubtful": "Nothing is wrong, but something is doubtful.",
    "wrong": "Something is wrong: correct it before you fit.",
}


async def body(session: Session) -> None:
    """The check, its verdicts, and what they propose."""
    if session.plan.robot is None or isinstance(session.robot(), Problem):
        parts.note("Pick a robot first; its description is checked even without a recording.")
        return
    _begin(session)
    last = next((run for run in runs(session.folder) if run.record.kind == "check"), None)
    if last is not None and last.succeeded and not session.busy:
        _verdicts(session, last)


def _begin(session: Session) -> None:
    plan = session.plan
    with parts.panel():
        names = ", ".join(recording.file for recording in plan.used)
        ui.label(f"Of {plan.robot}{f' with {names}' if names else ', the description only'}")
        ready = parts.all_mapped(session) and not session.busy

        def begin() -> None:
            parts.attempt(lambda: session.begin("check", partial(check_step, session.plan)))

        ui.button("Check", on_click=begin).props("no-caps").set_enabled(ready)
        parts.progress(session, "check")
        if plan.checked is not None and not session.store.is_checked and not session.busy:
            parts.note(
                "Robot, recordings, mapping or filter have changed since the last check: "
                "check again.",
                "doubt",
            )
        texts.commands(lambda: check_step(plan, next_run(session.folder, "check")))


def _verdicts(session: Session, run: FinishedRun) -> None:
    found = output(session.folder, run)
    grade = str(found.get("grade", ""))
    verdicts: list[dict[str, Any]] = found.get("verdicts", [])
    kind = {"wrong": "bad", "good": "good"}.get(grade, "doubt")
    parts.note(_SENTENCES.get(grade, grade), kind)
    if not session.store.is_checked:
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
        parts.grade(verdict["grade"])
        ui.label(verdict["key"]).classes("text-weight-bold")
    about = "" if verdict["subject"] in verdict["seen"] else f"{verdict['subject']}: "
    ui.label(page_words(f"{about}{verdict['seen']}"))


def _card(session: Session, verdict: dict[str, Any]) -> None:
    with parts.panel():
        _words(verdict)
        if verdict["cause"]:
            ui.label(page_words(f"Likely: {verdict['cause']}"))
        if verdict["cure"]:
            ui.label(page_words(f"→ {verdict['cure']}"))
        if verdict["key"] == "torque-lag":
            ui.label("The fit corrects this lag too (setting: Lag).").classes("dim")
        for file, name in (("robot", "the robot file"), ("mapping", "the mapping")):
            changes = wanted(verdict, file)
            if not changes:
                continue
            ui.button(
                f"Show the change to {name}",
                on_click=partial(_offer, session, verdict, file, changes),
            ).props(f'outline no-caps aria-label="Show the change to {name} for {verdict["key"]}"')


async def _offer(
    session: Session, verdict: dict[str, Any], file: str, changes: list[tuple[str, object]]
) -> None:
    folder, used = session.folder, None
    try:
        if file == "robot":
            name, before, after = _robot_change(session, changes)
        else:
            used = _used(session, verdict)
            name, before, after = await _mapping_change(session, used, changes)
    except DeltaidError as error:
        parts.warn(error)
        return

    def write() -> None:
        written, instead_of = name, before
        if used is None and before is None:
            written = own_copy(folder, session.plan.robot or "")
            instead_of = folder.text(written)
        folder.write(written, after, instead_of=instead_of)
        session.store.change(
            lambda plan: (
                plan.changed(robot=written)
                if used is None
                else plan.with_recording(used.changed(mapping=written))
            )
        )
        ui.notify(f"{written} is changed", type="positive")

    with ui.dialog(value=True) as dialog, ui.card().style("min-width: min(640px, 90vw)"):
        ui.label(f"Change {name}?").classes("text-h6")
        texts.difference(difference(name, before or "", after))
        with ui.row():

            def apply() -> None:
                dialog.close()
                parts.attempt(write)

            ui.button("Apply", on_click=apply).props("no-caps autofocus")
            ui.button("Leave it", on_click=dialog.close).props("flat no-caps")


def _robot_change(
    session: Session, changes: list[tuple[str, object]]
) -> tuple[str, str | None, str]:
    robot, folder = session.plan.robot or "", session.folder
    if robot in catalogue():
        name = folder.free_name(f"{robot}.yaml")
        return name, None, robot_cured(catalogue_text(robot), changes, name)
    return robot, folder.text(robot), robot_cured(folder.text(robot), changes, robot)


def _used(session: Session, verdict: dict[str, Any]) -> Used:
    """The recording that a verdict is on: of several it names its own."""
    used = session.plan.used
    for recording in used:
        if len(used) == 1 or str(verdict["subject"]).startswith(recording.file):
            return recording
    raise DeltaidError(
        "is of no single recording", where=str(verdict["key"]), cure="change the mappings by hand"
    )


async def _mapping_change(
    session: Session, used: Used, changes: list[tuple[str, object]]
) -> tuple[str, str | None, str]:
    name = used.mapping or mapping_name(session, used.file)
    before = session.folder.text(name) if session.folder.has(name) else None
    path, robot = str(session.folder.path(used.file)), session.place(session.plan.robot or "")
    after = await session.look(mapping_cured, path, robot, mapping_of(session, used), changes)
    if isinstance(after, Problem):
        raise DeltaidError(after.what, where=after.where, cure=after.cure)
    return name, before, after
