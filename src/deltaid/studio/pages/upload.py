"""Files that are dropped onto a page, or chosen, and go into the studio's folder."""

import tempfile
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from nicegui import events, ui

from deltaid.errors import DeltaidError
from deltaid.studio.look import Problem
from deltaid.studio.pages.parts import warn
from deltaid.studio.session import Session


def upload(
    session: Session,
    what: str,
    look: Callable[[Path], Awaitable[Problem | None]],
    then: Callable[[str], None],
    endings: Sequence[str] = (),
) -> None:
    """A place to drop files at, and a button to choose one.

    Args:
        what: is dropped, such as 'a robot file'.
        look: says why a file cannot be one; None if it may be.
        then: called with the name that the file has in the folder.
        endings: of names that are taken; all without any.
    """

    async def received(event: events.UploadEventArguments) -> None:
        name = session.folder.free_name(event.file.name)
        try:
            with tempfile.TemporaryDirectory(prefix=".dropped-", dir=session.folder.root) as place:
                part = Path(place) / name
                await event.file.save(part)
                if wrong := await look(part):
                    warn(wrong.inside(session.folder.root).inside(Path(Path(place).name)))
                    return
                name = session.folder.free_name(name)
                part.replace(session.folder.path(name))
        except OSError as error:
            what = f"cannot be written: {error.strerror or error}"
            cure = "make room in the folder, or the right to write to it"
            warn(DeltaidError(what, where=name, cure=cure))
            return
        if name != event.file.name:
            ui.notify(f"{event.file.name} is kept as {name}")
        then(name)

    def rejected() -> None:
        ends = " or ".join(endings)
        warn(DeltaidError("is not taken", where=what, cure=f"give a file that ends with {ends}"))

    field = ui.upload(on_upload=received, on_rejected=rejected, auto_upload=True, multiple=True)
    if endings:
        field.props(f'accept="{",".join(endings)}"')
    field.props(f'aria-label="Drop {what} here"')
    field.style("display: none")
    zone = ui.element("div").classes("drop")
    with zone:
        ui.label(f"Drop {what} here, or").classes("dim")
        ui.button(f"Choose {what}").props("outline dense no-caps").on(
            "click", js_handler=f"() => getElement({field.id}).$refs.qRef.pickFiles()"
        )
    uploader = f"getElement({field.id}).$refs.qRef"
    take = f"(e) => {{ e.preventDefault(); {uploader}.addFiles(e.dataTransfer.files) }}"
    zone.on("drop", js_handler=take)
    zone.on("dragover", js_handler="(e) => e.preventDefault()")
