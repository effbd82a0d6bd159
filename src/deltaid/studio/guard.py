"""Who may talk to the studio: its own page in this browser, and nobody else.

Any page of the web can send requests to this machine, and open websockets to it; with a name that
its owner points at 127.0.0.1 (DNS rebinding) it even looks like the studio's own. So each request
has to name this server (Host), come from its page if it says where it comes from (Origin), and hold
a cookie that the key of the printed address is exchanged for. A key opens the studio once: whoever
reads it later, in a history or a list of processes, does not get in. A websocket has to say where
it comes from, as browsers do.
"""

import html
import secrets
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")
_REFUSED = (
    "Not the studio's own page: open the address that `deltaid studio` has printed last; each "
    "opens it once.\n"
)
# Of keys and cookies: nobody guesses 128 bits.
_SECRET_BYTES = 16
# Whatever a page of the studio holds, it talks to this server only.
_POLICY = (
    b"default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; frame-ancestors 'self'; "
    b"form-action 'self'; base-uri 'self'"
)
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"SAMEORIGIN"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


def is_own(headers: Mapping[str, list[str]], port: int, *, websocket: bool) -> bool:
    """Whether a request names this server and comes from its own page.

    Args:
        headers: all values by lower-case name.
        port: where the server listens.
        websocket: whether it asks for one, which has to say where it comes from.
    """
    hosts = {f"{name}:{port}" for name in _NAMES}
    asked, origins = headers.get("host", []), headers.get("origin", [])
    if len(asked) != 1 or asked[0].lower() not in hosts or len(origins) > 1:
        return False
    if not origins:
        return not websocket
    return origins[0].lower() == f"http://{asked[0].lower()}"


class Guard:
    """ASGI middleware that refuses all but the studio's own page.

    Args:
        app: what it stands before.
        port: where the server listens.
        renewed: called when a key has been used, and another takes its place.

    Attributes:
        key: that opens the studio once, by an address that ends in `?key=…`.
    """

    def __init__(self, app: App, port: int, renewed: Callable[[], None] = lambda: None) -> None:
        self.app, self.port, self.renewed = app, port, renewed
        self.cookie = f"deltaid-studio-{port}"
        self.key, self._secret = (secrets.token_urlsafe(_SECRET_BYTES) for _ in range(2))

    @property
    def address(self) -> str:
        """What opens the studio, once."""
        return f"http://{HOST}:{self.port}/?key={self.key}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is the studio's own; the first request gets the cookie for its key."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = _headers(scope)
        websocket = scope["type"] == "websocket"
        if not is_own(headers, self.port, websocket=websocket):
            await _refuse(scope, send)
        elif not websocket and _equal(_asked(scope, "key"), self.key):
            await self._welcome(scope, send)
        elif _equal(_cookie(headers, self.cookie), self._secret):
            await self._pass(scope, receive, send)
        else:
            await _refuse(scope, send)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on; that a page which has been left gets no answer any more is no error."""
        left = False

        async def receiving() -> MutableMapping[str, Any]:
            nonlocal left
            message = await receive()
            left = left or message["type"] == "http.disconnect"
            return message

        try:
            await self.app(scope, receiving, _guarded(send))
        except RuntimeError:  # "No response returned.", as Starlette has it
            if not left:
                raise

    async def _welcome(self, scope: Scope, send: Send) -> None:
        """Exchange the key for a cookie, by a page that goes on to the studio without it.

        A redirection would not do: where a file has led to it, browsers keep a strict cookie back.
        """
        self.key = secrets.token_urlsafe(_SECRET_BYTES)
        self.renewed()
        cookie = f"{self.cookie}={self._secret}; Path=/; HttpOnly; SameSite=Strict"
        headers = [
            (b"content-type", b"text/html; charset=utf-8"),
            (b"cache-control", b"no-store"),
            (b"set-cookie", cookie.encode()),
        ]
        page = leading_to("/" + scope["path"].lstrip("/"))
        await send({"type": "http.response.start", "status": 200, "headers": [*headers, *_HEADERS]})
        await send({"type": "http.response.body", "body": page.encode()})


def leading_to(address: str) -> str:
    """A page that goes on to an address at once."""
    target = html.escape(address)
    refresh = f'<meta http-equiv="refresh" content="0; url={target}">'
    return f"<!doctype html>{refresh}<title>deltaid</title>"


def _equal(given: str, secret: str) -> bool:
    return secrets.compare_digest(given.encode(), secret.encode())


def _headers(scope: Scope) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return found


def _asked(scope: Scope, name: str) -> str:
    query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
    return query.get(name, [""])[0]


def _cookie(headers: Mapping[str, list[str]], name: str) -> str:
    for line in headers.get("cookie", []):
        try:
            found = SimpleCookie(line).get(name)
        except CookieError:
            continue
        if found is not None:
            return found.value
    return ""


def _guarded(send: Send) -> Send:
    async def sending(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            given = list(message.get("headers", ()))
            has = any(name.lower() == b"content-security-policy" for name, _ in given)
            policy = [] if has else [(b"content-security-policy", _POLICY)]
            message["headers"] = [*given, *_HEADERS, *policy]
        await send(message)

    return sending


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": _REFUSED.encode()})
