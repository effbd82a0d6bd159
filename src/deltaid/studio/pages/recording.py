"""Stage 2, recordings: files of the folder, the mapping of columns, and a preview."""

from functools import partial

from nicegui import ui

from deltaid.errors import DeltaidError
from deltaid.recording.contents import Contents, count_columns, read_contents
from deltaid.robot.description import RobotDescription
from deltaid.studio.edits import named, read, written
from deltaid.studio.pages import parts
from deltaid.studio.pages.figures import preview, signals
from deltaid.studio.pages.mapping import Form, form
from deltaid.studio.pages.upload import upload
from deltaid.studio.plan import Plan, Used
from deltaid.studio.session import Session, mapping_name

_USES = {"fit": "fit the model to it", "verify": "test the model on it", "aside": "leave it aside"}


async def body(session: Session) -> None:
    robot = session.robot()
    if not isinstance(robot, RobotDescription):
        parts.note("Pick a robot first: columns are proposed for its drives.")
        return
    _files(session, robot)
    for used in session.plan.recordings:
        if used.use != "aside":
            await _recording(session, used, robot)


def _files(session: Session, robot: RobotDescription) -> None:
    def forget(name: str) -> None:
        def without(plan: Plan) -> Plan:
            return plan.changed(recordings=tuple(r for r in plan.recordings if r.file != name))

        session.store.change(without)

    with parts.panel("Recordings"):
        upload(session, "a recording", count_columns, partial(_add, session, robot))
        ui.label(
            "CSV, Parquet, MATLAB, NumPy, HDF5, TwinCAT scopes, ROS bags; any names of columns."
        ).classes("dim")
        known = {recording.file: recording for recording in session.plan.recordings}
        for name in dict.fromkeys((*known, *session.folder.recordings())):
            with ui.row().classes("items-center w-full"):
                ui.label(name).classes("grow long")
                used = known.get(name)
                if used is None:
                    ui.button("Use it", on_click=partial(_add, session, robot, name)).props(
                        f'outline dense aria-label="Use {name}"'
                    )
                    continue
                if session.folder.has(name):
                    ui.select(
                        _USES,
                        value=used.use,
                        on_change=lambda event, used=used: parts.change_use(
                            session, used, use=event.value
                        ),
                    ).props(f'aria-label="What {name} is for"')
                else:
                    ui.label("is missing").classes("grade wrong")
                ui.button("Forget it", on_click=partial(forget, name)).props(
                    f'flat dense aria-label="Forget {name}"'
                ).tooltip("The file stays in the folder")


async def _add(session: Session, robot: RobotDescription, name: str) -> None:
    """Use a recording; it verifies if others fit a model and none verifies. It shares the mapping
    of a recording with the same columns."""
    mapping = None
    for recording in session.plan.recordings:
        if recording.file != name and await _has_columns_of(session, robot, recording, name):
            mapping = mapping or recording.mapping

    def edit(plan: Plan) -> Plan:
        use = "verify" if plan.fitted and not plan.verified else "fit"
        return plan.with_recording(Used(file=name, use=use, mapping=mapping))

    session.store.change(edit)


async def _contents(session: Session, robot: RobotDescription, name: str) -> Contents:
    return await session.read_cached(
        read_contents, str(session.folder.path(name)), robot.linear_drives
    )


async def _has_columns_of(session: Session, robot: RobotDescription, used: Used, name: str) -> bool:
    """Whether a recording exists and has the same columns as another one."""
    try:
        mine, theirs = [await _contents(session, robot, file) for file in (used.file, name)]
    except DeltaidError:
        return False
    return [c.address for c in mine.columns] == [c.address for c in theirs.columns]


async def _recording(session: Session, used: Used, robot: RobotDescription) -> None:
    with parts.panel(f"{used.file}: which column is what"):
        if not session.folder.has(used.file):
            gone = "is no longer in the folder: put it back there, or forget it above."
            parts.note(f"{used.file} {gone}", "bad")
            return
        with parts.waiting():
            contents = await _contents(session, robot, used.file)
        size = f"{contents.rows:,} rows".replace(",", " ")
        ui.label(f"{size}, {len(contents.columns)} columns").classes("dim")
        for text in contents.proposal.warnings:
            parts.note(text, "doubt")
        if used.mapping is None:
            _proposal(session, used, contents, robot)
            return
        _another(session, used)
        state = Form(
            session, used, contents, robot, read(session.folder.text(used.mapping), used.mapping)
        )
        form(state)
        _figure(state, used, contents, ui.column().classes("w-full figure"))


def _figure(state: Form, used: Used, contents: Contents, place: ui.column) -> None:
    """The recording as mapped; raw signals while the mapping is incomplete."""
    drawn: object = None

    async def draw() -> None:
        nonlocal drawn
        wanted = state.missing or state.data
        if wanted == drawn or (state.missing and isinstance(drawn, str)):
            return
        drawn = wanted
        place.clear()
        with place, parts.showing_errors():
            if state.missing:
                await signals(state.session, used, contents, state.data, state.dof)
            else:
                await preview(state.session, used, state.data)

    ui.timer(parts.REDRAW, draw)


def _proposal(session: Session, used: Used, contents: Contents, robot: RobotDescription) -> None:
    """A proposed mapping with its reasons; the file is written when the user accepts it."""
    guess, name = contents.proposal, mapping_name(session, used.file)
    state = Form(session, used, contents, robot, guess.data)
    lines = [f"· {reason}" for reason in guess.reasons] or ["· no column by its name"]
    head = "Found without doubt" if guess.certain else "Proposed"
    parts.note(f"{head}, and not used yet:\n" + "\n".join(lines))
    fitting = _fitting(session, contents, state.dof)
    with ui.row():
        for mapping, sharing in fitting.items():
            ui.button(
                f"Use {mapping}{sharing}",
                on_click=partial(parts.change_use, session, used, mapping=mapping),
            )
    figure = ui.column().classes("w-full figure")
    form(state)
    take = ui.button(f"Use these, write {name}", on_click=partial(_take, state, used, name))
    take.props("outline" if fitting else "").set_enabled(not state.missing)
    state.changed.append(lambda: take.set_enabled(not state.missing))
    _figure(state, used, contents, figure)


def _fitting(session: Session, contents: Contents, dof: int) -> dict[str, str]:
    """Mapping files whose columns all exist in this recording, with the recordings that use
    them."""
    there, mapped = {column.address for column in contents.columns}, dict[str, str]()
    for name in session.folder.mappings():
        try:
            names = named(read(session.folder.text(name), name), dof)
        except DeltaidError:  # no mapping, or for another number of drives
            continue
        if names and names <= there:
            of = [r.file for r in session.plan.recordings if r.mapping == name]
            mapped[name] = f", as {', '.join(of)} does" if of else ""
    return mapped


def _another(session: Session, used: Used) -> None:
    """Recordings that share the mapping, and a button to use a separate one."""
    others = [
        r.file for r in session.plan.recordings if r.mapping == used.mapping and r.file != used.file
    ]
    with ui.row().classes("items-center"):
        if others:
            ui.label(f"{used.mapping} is the mapping of {', '.join(others)} too.")
        ui.button(
            "Choose another mapping",
            on_click=partial(parts.change_use, session, used, mapping=None),
        ).props(f'flat dense aria-label="Choose another mapping for {used.file}"')


async def _take(state: Form, used: Used, name: str) -> None:
    """Write the mapping; unmapped recordings with the same columns use it too."""
    session = state.session
    shared = [
        recording
        for recording in session.plan.recordings
        if recording.mapping is None
        and await _has_columns_of(session, state.robot, recording, used.file)
    ]

    def edit(plan: Plan) -> Plan:
        for recording in shared:
            plan = plan.with_recording(recording.changed(mapping=name))
        return plan

    session.folder.write(name, written(state.data, name))
    session.drafts.pop(state.key, None)
    session.store.change(edit)
