"""Protection of a local server: it answers only its own page.

Any web page can open a websocket to this machine, and through a name that resolves to 127.0.0.1
(DNS rebinding) it even looks like the server's own. So the server checks the origin of a request
(Origin) and the server that it names (Host).
"""

import socket
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

from deltaid.errors import DeltaidError

# Period of polling for what no event reports, such as changed files, or Ctrl-C on some systems [s].
POLL = 0.5
# Only this machine can reach this address.
HOST = "127.0.0.1"


def free_port(candidates: Iterable[int]) -> int:
    """The first free port of some candidates; 0 is any free one.

    Raises:
        DeltaidError: none is available.
    """
    port, reason = 0, ""
    for port in candidates:
        try:
            with socket.create_server((HOST, port)) as trial:
                return int(trial.getsockname()[1])
        except OSError as error:
            reason = error.strerror or str(error)
    cure = "give another one, or 0 for any that is free"
    raise DeltaidError(f"cannot be used: {reason}", where=f"--port {port}", cure=cure)


@contextmanager
def answering_own_page_only() -> Generator[None, None, None]:
    """Make servers that viser starts inside the block refuse all other pages.

    viser has no such setting; its websocket library calls `process_request` for every request.

    Raises:
        DeltaidError: this version of viser starts its server in another way.
    """
    from websockets.asyncio import server as library

    serve, guarded = library.serve, False

    def serve_own_page(*arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal guarded
        guarded = True

        def process(connection: Any, request: Any) -> Any:
            hosts, origins, upgrades = map(request.headers.get_all, ("Host", "Origin", "Upgrade"))
            if not same_origin(
                hosts, origins, connection.local_address[1], websocket=bool(upgrades)
            ):
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


def same_origin(
    hosts: Sequence[str], origins: Sequence[str], port: int, *, websocket: bool
) -> bool:
    """Whether a request names this server and comes from its own page.

    Args:
        hosts, origins: all values of these headers.
        port: that the server listens on.
        websocket: whether it requests a websocket, which needs an Origin; every browser sends it.
    """
    own = [f"{HOST}:{port}", f"localhost:{port}"]
    if len(hosts) != 1 or hosts[0].lower() not in own or len(origins) > 1:
        return False
    return origins[0].lower() in [f"http://{host}" for host in own] if origins else not websocket
