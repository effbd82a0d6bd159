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


class _Field(ui.upload):
    """Takes files outside of what is redrawn: a file that is being chosen or sent while a check
    ends, which redraws all pages, would be lost.

    Attributes:
        take: called with each file.
        refuse: called for files with other endings.
    """

    take: Callable[[events.UploadEventArguments], Awaitable[None]]
    refuse: Callable[[], None]

    def __init__(self) -> None:
        super().__init__(
            on_upload=lambda event: self.take(event),
            on_rejected=lambda: self.refuse(),
            auto_upload=True,
            multiple=True,
        )
        self.style("display: none")
        # A file may be given again, after it has been removed or changed.
        self.on("uploaded", js_handler=f"() => {_uploader(self)}.removeUploadedFiles()")


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

    field = _field()
    field.take, field.refuse = received, rejected
    field.props(f'aria-label="Drop {what} here"')
    if endings:
        field.props(f'accept="{",".join(endings)}"')
    with ui.element("div").classes("drop") as zone:
        ui.label(f"Drop {what} here, or").classes("dim")
        ui.button(f"Choose {what}").props("outline dense").on(
            "click", js_handler=f"() => {_uploader(field)}.pickFiles()"
        )
    add = f"{_uploader(field)}.addFiles"
    zone.on("drop", js_handler=f"(e) => {{ e.preventDefault(); {add}(e.dataTransfer.files) }}")
    zone.on("dragover", js_handler="(e) => e.preventDefault()")


def _field() -> _Field:
    """The one field of a page."""
    client = ui.context.client
    for element in client.elements.values():
        if isinstance(element, _Field):
            return element
    with client.content:
        return _Field()


def _uploader(field: _Field) -> str:
    """The widget of a field, in JavaScript."""
    return f"getElement({field.id}).$refs.qRef"
