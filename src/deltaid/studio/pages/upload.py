"""A place to drop files into the studio's folder."""

import tempfile
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

from nicegui import events, ui

from deltaid.errors import DeltaidError
from deltaid.files import refusing
from deltaid.studio.folder import Folder
from deltaid.studio.session import Session


def upload(
    session: Session,
    what: str,
    look: Callable[[Any], object],
    then: Callable[[str], Awaitable[None] | None],
    endings: Sequence[str] = (),
) -> None:
    """A place to drop files, and a button to choose one.

    Args:
        what: is dropped, such as 'a robot file'.
        look: refuses an unsuitable file, in a separate process.
        then: called with the file's name in the folder.
        endings: of accepted names; all if empty.
    """

    async def received(event: events.UploadEventArguments) -> None:
        name = session.folder.free_name(event.file.name)
        cure = "make room in the folder, or the right to write to it"
        with (
            refusing(name, "cannot be written", cure),
            tempfile.TemporaryDirectory(prefix=".dropped-", dir=session.folder.root) as place,
        ):
            part = Path(place) / name
            await event.file.save(part)
            with Folder(Path(part.parent.name)).called_by_name():
                await session.read(look, part)
            name = session.folder.free_name(name)
            part.replace(session.folder.path(name))
        if name != event.file.name:
            ui.notify(f"{event.file.name} is kept as {name}")
        if (after := then(name)) is not None:
            await after

    def rejected() -> None:
        raise DeltaidError(
            "is not taken", where=what, cure=f"give a file that ends with {' or '.join(endings)}"
        )

    field = ui.upload(on_upload=received, on_rejected=rejected, auto_upload=True, multiple=True)
    field.props(f'aria-label="Drop {what} here"').style("display: none")
    if endings:
        field.props(f'accept="{",".join(endings)}"')
    with ui.element("div").classes("drop") as zone:
        ui.label(f"Drop {what} here, or").classes("dim")
        ui.button(f"Choose {what}").props("outline dense").on(
            "click", js_handler=f"() => getElement({field.id}).$refs.qRef.pickFiles()"
        )
    add = f"getElement({field.id}).$refs.qRef.addFiles"
    zone.on("drop", js_handler=f"(e) => {{ e.preventDefault(); {add}(e.dataTransfer.files) }}")
    zone.on("dragover", js_handler="(e) => e.preventDefault()")
