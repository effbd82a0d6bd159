"""A server on this machine that answers its own page only, whatever else the browser shows.

A browser lets any page of the web open a websocket to this machine, and a name that its owner
points at 127.0.0.1 (DNS rebinding) even makes such a page look like the server's own. So the
server looks at where a request comes from (Origin) and whom it believes to ask (Host).
"""

from collections.abc import Generator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

from deltaid.errors import DeltaidError

_NAMES = ("127.0.0.1", "localhost")


@contextmanager
def answering_own_page_only() -> Generator[None, None, None]:
    """Servers that viser starts inside refuse all others.

    viser has no setting for it; its websocket library asks `process_request` about every request.

    Raises:
        DeltaidError: this version of viser starts its server in another way.
    """
    from websockets.asyncio import server as library

    serve, guarded = library.serve, False

    def serve_own_page(*arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal guarded
        guarded = True

        def process(connection: Any, request: Any) -> Any:
            if not is_own(request.headers, connection.local_address[1]):
                return connection.respond(HTTPStatus.FORBIDDEN, "not this server's own page\n")
            return process_request(connection, request)

        return serve(*arguments, process_request=process, **options)

    library.serve = serve_own_page
    try:
        yield
    finally:
        library.serve = serve
    if not guarded:
        raise DeltaidError(
            "this version of viser cannot be kept from talking to other pages of the web",
            where="--live",
            cure="install another one: pip install viser==1.1.1",
        )


def is_own(headers: Any, port: int) -> bool:
    """Whether a request with these headers is for this server and from its page.

    A websocket has to say where it comes from, as every browser makes it do.
    """
    hosts = {f"{name}:{port}" for name in _NAMES}
    asked, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(asked) != 1 or asked[0] not in hosts or len(origins) > 1:
        return False
    if not origins:
        return not headers.get_all("Upgrade")
    return origins[0].removeprefix("http://") in hosts and origins[0].startswith("http://")
