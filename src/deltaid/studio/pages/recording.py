"""Stage 2: recordings. Files of the folder, which column is what, and a preview."""

from functools import partial
from pathlib import Path

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.recording.contents import Contents, count_columns, read_contents
from deltaid.robot.description import RobotDescription
from deltaid.studio import look
from deltaid.studio.edits import Data, named, read, written
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import preview
from deltaid.studio.pages.mapping import form
from deltaid.studio.pages.parts import upload
from deltaid.studio.plan import Plan, Used
from deltaid.studio.session import Session, mapping_name

_USES = {"fit": "fit the model to it", "verify": "test the model on it", "aside": "leave it aside"}


async def body(session: Session) -> None:
    """The folder's recordings, and the mapping and preview of each."""
    robot = session.robot()
    if not isinstance(robot, RobotDescription):
        parts.note("Pick a robot first: columns are proposed for its drives.")
        return
    _files(session)
    for used in session.plan.recordings:
        if used.use != "aside":
            await _recording(session, used, robot)


def _files(session: Session) -> None:
    with parts.panel("Recordings"):
        upload(session, "a recording", partial(_readable, session), partial(_add, session))
        ui.label(
            "CSV, Parquet, MATLAB, NumPy, HDF5, TwinCAT scopes, ROS bags; any names of columns."
        ).classes("dim")
        known = {recording.file: recording for recording in session.plan.recordings}
        for name in dict.fromkeys((*known, *session.folder.recordings())):
            with ui.row().classes("items-center w-full"):
                ui.label(name).classes("grow long")
                used = known.get(name)
                if used is None:
                    ui.button("Use it", on_click=partial(_add, session, name)).props(
                        f'outline dense no-caps aria-label="Use {name}"'
                    )
                    continue
                if session.folder.has(name):
                    ui.select(
                        _USES,
                        value=used.use,
                        on_change=lambda event, used=used: parts.change_use(
                            session, used, use=event.value
                        ),
                    ).props(f'dense outlined aria-label="What {name} is for"')
                else:
                    ui.label("is missing").classes("grade wrong")
                ui.button("Forget it", on_click=partial(_forget, session, name)).props(
                    f'flat dense no-caps aria-label="Forget {name}"'
                ).tooltip("The file stays in the folder")


async def _readable(session: Session, path: Path) -> look.Problem | None:
    found = await session.glance(count_columns, str(path))
    return found if isinstance(found, look.Problem) else None


def _add(session: Session, name: str) -> None:
    """Take a recording; the second one tests."""

    def edit(plan: Plan) -> Plan:
        use = "verify" if plan.fitted and not plan.verified else "fit"
        return plan.with_recording(Used(file=name, use=use))

    parts.attempt(lambda: session.store.change(edit))


def _forget(session: Session, name: str) -> None:
    parts.attempt(lambda: session.store.change(lambda plan: plan.without_recording(name)))


async def _recording(session: Session, used: Used, robot: RobotDescription) -> None:
    with parts.panel(f"{used.file}: which column is what"):
        if not session.folder.has(used.file):
            parts.note(
                f"{used.file} is no longer in the folder: put it back there, or forget it above.",
                "bad",
            )
            return
        linear = tuple(robot.is_linear(drive) for drive in robot.drives)
        path = str(session.folder.path(used.file))
        with parts.waiting():
            contents = await session.look(read_contents, path, linear)
        if isinstance(contents, look.Problem):
            parts.problem(contents)
            return
        size = f"{contents.rows:,} rows".replace(",", " ")
        ui.label(f"{size}, {len(contents.columns)} columns").classes("dim")
        for text in contents.warnings:
            parts.note(text, "doubt")
        if used.mapping is None:
            _proposal(session, used, contents, robot)
            if contents.proposal.complete:
                await preview(session, used, contents.proposal.data)
            return
        try:
            data = read(session.folder.text(used.mapping), used.mapping)
        except DeltaidError as error:
            parts.problem(error)
            _another(session, used)
            return
        _another(session, used)
        form(session, used, contents, robot, data)
        await preview(session, used, data)


def _proposal(session: Session, used: Used, contents: Contents, robot: RobotDescription) -> None:
    """What may be right, and why; a file is written when the user takes it."""
    guess, name = contents.proposal, mapping_name(session, used.file)
    lines = [f"· {reason}" for reason in guess.reasons]
    if guess.missing:
        lines.append(f"· not found: {', '.join(guess.missing)}; these are to be named by hand")
    head = "Found without doubt" if guess.certain else "Proposed"
    parts.note(f"{head}, and not used yet:\n" + "\n".join(lines))
    fitting = _fitting(session, contents, len(robot.drives))
    with ui.row():
        for mapping, of in fitting.items():
            point = partial(parts.change_use, session, used, mapping=mapping)
            ui.button(f"Use {mapping}{of}", on_click=point).props("no-caps")
        ui.button(
            f"{'Name the rest by hand' if guess.missing else 'Use these'}, write {name}",
            on_click=lambda: _take(session, used, name, guess.valid_data),
        ).props("no-caps outline" if fitting else "no-caps")


def _fitting(session: Session, contents: Contents, dof: int) -> dict[str, str]:
    """Mapping files whose columns are all in this recording too, and what shares each."""
    there, found = {column.address for column in contents.columns}, dict[str, str]()
    for name in session.folder.mappings():
        try:
            names = named(read(session.folder.text(name), name), dof)
        except DeltaidError:  # no mapping, or not of these drives
            continue
        if names and names <= there:
            of = [
                recording.file for recording in session.plan.recordings if recording.mapping == name
            ]
            found[name] = f", as {', '.join(of)} does" if of else ""
    return found


def _another(session: Session, used: Used) -> None:
    """Who shares the mapping, and the way to another one."""
    others = [
        recording.file
        for recording in session.plan.recordings
        if recording.mapping == used.mapping and recording.file != used.file
    ]
    with ui.row().classes("items-center"):
        if others:
            ui.label(f"{used.mapping} is the mapping of {', '.join(others)} too.")
        point = partial(parts.change_use, session, used, mapping=None)
        ui.button("Choose another mapping", on_click=point).props(
            f'flat dense no-caps aria-label="Choose another mapping for {used.file}"'
        )


def _take(session: Session, used: Used, name: str, data: Data) -> None:
    def do() -> None:
        session.folder.write(name, written(data, name))
        session.store.change(lambda plan: plan.with_recording(used.changed(mapping=name)))

    parts.attempt(do)
