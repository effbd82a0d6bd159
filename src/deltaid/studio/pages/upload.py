"""Files that are dropped onto a page, or chosen, and go into the studio's folder."""

from collections.abc import Callable, Sequence

from nicegui import events, ui

from deltaid.errors import DeltaidError
from deltaid.studio.pages.parts import warn
from deltaid.studio.session import Session


def upload(
    session: Session, what: str, then: Callable[[str], None], endings: Sequence[str] = ()
) -> None:
    """A place to drop files at, and a button to choose one.

    Args:
        what: is dropped, such as 'a robot file'.
        then: called with the name that the file has in the folder.
        endings: of names that are offered; all without any.
    """

    async def received(event: events.UploadEventArguments) -> None:
        name = session.folder.free_name(event.file.name)
        part = session.folder.root / f".{name}.part"
        try:
            await event.file.save(part)
            part.replace(session.folder.path(name))
        except OSError as error:
            warn(DeltaidError(f"cannot be written: {error.strerror or error}", where=name))
            return
        finally:
            part.unlink(missing_ok=True)
        if name != event.file.name:
            ui.notify(f"{event.file.name} is kept as {name}")
        then(name)

    field = ui.upload(on_upload=received, auto_upload=True, multiple=True).classes("hidden-upload")
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
