"""The studio's server: NiceGUI on this machine only, protected by a guard.

Any web page can send requests and open websockets to this machine; through a name that resolves to
127.0.0.1 (DNS rebinding) it even looks like the studio's own. So each request must name this server
(Host), come from its page if it has an Origin, and have a cookie, which is exchanged for the key in
the printed address. A key works once, so a copy from a history or a list of processes is useless.
Websockets need an Origin, which browsers always send.
"""

import asyncio
import html
import logging
import secrets
import tempfile
import webbrowser
from collections.abc import Callable, Generator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import app, background_tasks, ui
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from deltaid.errors import DeltaidError
from deltaid.studio.folder import Folder
from deltaid.studio.jobs import GRACE
from deltaid.studio.pages.frame import build
from deltaid.studio.session import Session
from deltaid.view.own_page import HOST, same_origin

_REFUSED = (
    "Not the studio's own page: open the address that `deltaid studio` has printed last; each "
    "opens it once.\n"
)
# Content security policy: pages communicate with this server only.
_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'self'; "
    "form-action 'self'; base-uri 'self'"
)
_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "x-frame-options": "SAMEORIGIN",
    "cross-origin-resource-policy": "same-origin",
}


class Guard:
    """ASGI middleware that refuses all requests but those of the studio's own page.

    Args:
        app: the protected application.
        port: that the server listens on.
        renewed: called when a key has been used and a new one replaces it.

    Attributes:
        key: opens the studio once, by an address that ends in `?key=…`.
    """

    def __init__(self, app: ASGIApp, port: int, renewed: Callable[[], None] = lambda: None) -> None:
        self.app, self.port, self.renewed = app, port, renewed
        self.cookie = f"deltaid-studio-{port}"
        self.key, self._secret = (secrets.token_urlsafe() for _ in range(2))

    @property
    def address(self) -> str:
        """The address that opens the studio once."""
        return f"http://{HOST}:{self.port}/?key={self.key}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on requests of the studio's own page; the first one exchanges its key for the
        cookie."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        asked, websocket = HTTPConnection(scope), scope["type"] == "websocket"
        hosts, origins = asked.headers.getlist("host"), asked.headers.getlist("origin")
        # A cookie belongs to one host name of this machine, and so must the page.
        if same_origin(hosts, origins, self.port, websocket=websocket) and (
            not origins or origins[0].lower() == f"http://{hosts[0].lower()}"
        ):
            if not websocket and _equal(asked.query_params.get("key", ""), self.key):
                await self._welcome(scope, receive, send)
                return
            if _equal(asked.cookies.get(self.cookie, ""), self._secret):
                await self._pass(scope, receive, send)
                return
        if websocket:
            await send({"type": "websocket.close", "code": 1008})
        else:
            await PlainTextResponse(_REFUSED, 403)(scope, receive, send)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on a request; if the page was left, it gets no answer, which is no error."""
        left = False

        async def receiving() -> Message:
            nonlocal left
            message = await receive()
            left = left or message["type"] == "http.disconnect"
            return message

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(_HEADERS)
                headers.setdefault("content-security-policy", _POLICY)
            await send(message)

        try:
            await self.app(scope, receiving, sending)
        except RuntimeError:  # Starlette's "No response returned."
            if not left:
                raise

    async def _welcome(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Exchange the key for a cookie, with a page that continues to the studio without the key.

        A redirect would fail: if a local file has led to it, browsers withhold a strict cookie.
        """
        self.key = secrets.token_urlsafe()
        self.renewed()
        cookie = f"{self.cookie}={self._secret}; Path=/; HttpOnly; SameSite=Strict"
        page = leading_to("/" + scope["path"].lstrip("/"))
        headers = {"cache-control": "no-store", "set-cookie": cookie, **_HEADERS}
        await HTMLResponse(page, headers=headers)(scope, receive, send)


def leading_to(address: str) -> str:
    """A page that forwards to an address at once."""
    target = html.escape(address)
    refresh = f'<meta http-equiv="refresh" content="0; url={target}">'
    return f"<!doctype html>{refresh}<title>deltaid</title>"


def _equal(given: str, secret: str) -> bool:
    return secrets.compare_digest(given.encode(), secret.encode())


_FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" '
    'rx="7" fill="#1f5fa8"/><path d="M6 8h20L16 25z" fill="none" stroke="#fff" stroke-width="3" '
    'stroke-linejoin="round"/></svg>'
)
# Ports that are tried by default.
PORTS = (*range(8090, 8110), 0)


async def _tell(guard: Guard, say: Callable[[str], None], page: Path | None) -> None:
    """Report the address and open the page once the server answers."""
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
    """A page that only this account can read and that leads to the studio, so that the browser's
    command line, which all accounts can read, contains no key."""
    with tempfile.NamedTemporaryFile(
        "w", dir=folder, prefix="open-studio-", suffix=".html", encoding="utf-8", delete=False
    ) as file:
        file.write(leading_to(guard.address))
    page = Path(file.name)
    try:
        yield page
    finally:
        page.unlink(missing_ok=True)


def serve(path: Path, port: int, *, show: bool, say: Callable[[str], None]) -> None:
    """Serve a folder until Ctrl-C.

    Args:
        path: of the folder, which is made if it does not exist.
        port: a free one.
        show: whether to open a browser.
        say: called with the address once the server answers, and with the next one when that is
            used.

    Raises:
        DeltaidError: the folder cannot be used.
    """
    session = Session(Folder.open(path))
    whole = FastAPI(openapi_url=None)
    guard = Guard(whole, port)  # wraps everything else that the library adds
    build(session)
    # Errors that a page shows are not logged as defects.
    logging.getLogger("nicegui").addFilter(lambda line: not isinstance(line.msg, DeltaidError))
    with _opening(guard, session.folder.root) if show else nullcontext() as page:

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
            reconnect_timeout=10.0,  # s; longer than a reload
            show_welcome_message=False,
        )
        uvicorn.run(
            guard,
            host=HOST,
            port=port,
            log_level="error",
            proxy_headers=False,
            timeout_graceful_shutdown=GRACE,
        )
