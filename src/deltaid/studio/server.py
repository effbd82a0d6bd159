"""The studio's server: NiceGUI on this machine only, behind a guard."""

import asyncio
import os
import socket
import tempfile
import webbrowser
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from deltaid.errors import DeltaidError
from deltaid.libraries import require
from deltaid.studio.folder import Folder
from deltaid.studio.guard import HOST, Guard, leading_to
from deltaid.studio.session import Session

# The first port that is tried if none is asked for.
DEFAULT_PORT = 8090
# Seconds a page may be away, as while it is reloaded, before its state in the server is dropped.
_AWAY = 10.0
# Seconds that open pages have when the server ends.
_LEAVE = 1


def require_nicegui() -> None:
    """Find out whether the library behind the studio is there.

    Raises:
        DeltaidError: it is not installed.
    """
    require(
        "nicegui",
        by="deltaid studio",
        name="NiceGUI",
        install="pip install '.[studio]' in a clone of deltaid, or pip install 'nicegui>=3'",
    )


def port_for(wanted: int | None) -> int:
    """A free port of this machine: the one wanted, or from the default one on.

    Raises:
        DeltaidError: it cannot be had.
    """
    candidates = (wanted,) if wanted is not None else (*range(DEFAULT_PORT, DEFAULT_PORT + 20), 0)
    reason = ""
    for port in candidates:
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((HOST, port))
            except OSError as error:
                reason = error.strerror or str(error)
                continue
            return int(trial.getsockname()[1])
    raise DeltaidError(
        f"cannot be used: {reason}", where=f"--port {wanted}", cure="give another one, or 0 for any"
    )


async def _tell(guard: Guard, say: Callable[[str], None], page: Path | None) -> None:
    """Say the address, and open the page that leads there, once something answers."""
    while True:
        try:
            _, writer = await asyncio.open_connection(HOST, guard.port)
        except OSError:
            await asyncio.sleep(0.02)
            continue
        writer.close()
        say(guard.address)
        if page is not None:
            await asyncio.to_thread(webbrowser.open, page.as_uri())
        return


@contextmanager
def _opening(guard: Guard, folder: Path) -> Generator[Path, None, None]:
    """A page for this account alone that leads to the studio: in the command line of a browser,
    which all accounts can read, stands its name and no key."""
    handle, name = tempfile.mkstemp(dir=folder, prefix="open-studio-", suffix=".html")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(leading_to(guard.address))
    try:
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


def serve(path: Path, port: int, *, show: bool, say: Callable[[str], None]) -> None:
    """Serve a folder until Ctrl-C.

    Args:
        path: of the folder; made if there is none.
        port: a free one.
        show: whether to open a browser.
        say: called with the address once it answers, and with another one when that was used.

    Raises:
        DeltaidError: the folder cannot be used.
    """
    import uvicorn
    from fastapi import FastAPI
    from nicegui import app, background_tasks, ui

    from deltaid.studio.pages.frame import build

    session = Session(Folder.open(path))
    whole = FastAPI(openapi_url=None)
    guard = Guard(whole, port)  # before everything else, whatever the library adds
    build(session)
    with ExitStack() as stack:
        page = stack.enter_context(_opening(guard, session.folder.root)) if show else None

        def renewed() -> None:
            if page is not None:
                page.unlink(missing_ok=True)
            say(guard.address)

        guard.renewed = renewed
        app.on_startup(session.warm)
        app.on_shutdown(session.close)
        app.on_startup(lambda: background_tasks.create(_tell(guard, say, page), name="tell"))
        ui.run_with(
            whole,
            title="deltaid studio",
            favicon=_FAVICON,
            dark=None,
            reconnect_timeout=_AWAY,
            show_welcome_message=False,
        )
        uvicorn.run(
            guard,
            host=HOST,
            port=port,
            log_level="error",
            proxy_headers=False,
            timeout_graceful_shutdown=_LEAVE,
        )


_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" '
    'rx="7" fill="#1f5fa8"/><path d="M6 8h20L16 25z" fill="none" stroke="#fff" stroke-width="3" '
    'stroke-linejoin="round"/></svg>'
)
