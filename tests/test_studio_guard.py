"""Who may talk to the studio: its own page with the key, and nobody else."""

import asyncio

import pytest

from deltaid.studio.server import Guard


def _scope(headers: list[tuple[str, str]], query: str = "", kind: str = "http", path: str = "/"):
    """A request as the server hands it on."""
    return {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers],
    }


def _asked(headers: list[tuple[str, str]], query: str = "", kind: str = "http"):
    """What the guard of a server on port 8090 answers, whose key and cookie are 'word'."""
    sent: list[dict] = []

    async def inner(scope, receive, send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message) -> None:
        sent.append(message)

    guard = Guard(inner, 8090)
    guard.key = guard._secret = "word"
    asyncio.run(guard(_scope(headers, query, kind), None, send))
    return sent[0]


OWN = ("host", "127.0.0.1:8090")
COOKIE = ("cookie", "deltaid-studio-8090=word")
PAGE = ("origin", "http://127.0.0.1:8090")


@pytest.mark.parametrize(
    "headers",
    [
        [],
        [OWN],
        [COOKIE],
        [("host", "evil.example"), COOKIE],
        [("host", "evil.example:8090"), COOKIE],
        [("host", "127.0.0.1:8091"), COOKIE],
        [OWN, OWN, COOKIE],
        [OWN, COOKIE, ("origin", "http://evil.example")],
        [OWN, COOKIE, ("origin", "http://localhost:8090")],
        [OWN, COOKIE, ("origin", "https://127.0.0.1:8090")],
        [OWN, COOKIE, ("origin", "null")],
        [OWN, COOKIE, PAGE, PAGE],
        [OWN, PAGE, ("cookie", "deltaid-studio-8090=wort")],
        [OWN, PAGE, ("cookie", "deltaid-studio-8091=word")],
    ],
)
def test_foreign_hosts_origins_and_tokens_are_refused(headers: list[tuple[str, str]]) -> None:
    assert _asked(headers)["status"] == 403
    assert _asked(headers, kind="websocket") == {"type": "websocket.close", "code": 1008}


def test_the_own_page_is_answered() -> None:
    for headers in ([OWN, COOKIE], [OWN, COOKIE, PAGE]):
        answer = _asked(headers)
        assert answer["status"] == 200
        assert b"default-src 'self'" in dict(answer["headers"])[b"content-security-policy"]
    assert _asked([OWN, COOKIE, PAGE], kind="websocket")["status"] == 200
    assert _asked([OWN, COOKIE], kind="websocket")["code"] == 1008  # browsers say where from


def test_a_key_becomes_a_cookie_once_and_leaves_the_address() -> None:
    sent: list[dict] = []
    renewed: list[str] = []

    async def send(message) -> None:
        sent.append(message)

    guard = Guard(lambda *_: pytest.fail("was let in"), 8090, lambda: renewed.append(guard.address))
    first = guard.key

    def ask(query: str, path: str = "/") -> dict:
        sent.clear()
        asyncio.run(guard(_scope([OWN], query, path=path), None, send))
        return sent[0]

    assert ask("key=wort")["status"] == 403
    answer = ask(f"key={first}", path='//evil.example/"x')
    cookie = dict(answer["headers"])[b"set-cookie"].decode()
    assert answer["status"] == 200
    assert b'content="0; url=/evil.example/&quot;x"' in sent[1]["body"]
    assert first not in cookie
    assert "HttpOnly; SameSite=Strict" in cookie
    assert ask(f"key={first}")["status"] == 403
    assert renewed == [guard.address]
    assert ask(renewed[0].partition("?")[2])["status"] == 200
    assert _asked([("host", "evil.example")], query="key=word")["status"] == 403


@pytest.mark.parametrize("left", [True, False])
def test_an_answer_that_nobody_waits_for_is_no_error(left: bool) -> None:
    async def inner(scope, receive, send) -> None:
        await receive()
        raise RuntimeError("No response returned.")

    async def receive() -> dict:
        return {"type": "http.disconnect" if left else "http.request"}

    async def send(message) -> None:
        raise AssertionError(message)

    guard = Guard(inner, 8090)
    guard._secret = "word"
    asked = guard(_scope([OWN, COOKIE]), receive, send)
    if left:
        asyncio.run(asked)
    else:
        with pytest.raises(RuntimeError, match="No response"):
            asyncio.run(asked)
