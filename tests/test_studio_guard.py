"""Who may talk to the studio: its own page with the token, and nobody else."""

import asyncio

import pytest

from deltaid.studio.guard import Guard


def _asked(headers: list[tuple[str, str]], path: str = "/", query: str = "", kind: str = "http"):
    """What the guard of a server on port 8090 with the token 'word' answers."""
    sent: list[dict] = []

    async def inner(scope, receive, send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message) -> None:
        sent.append(message)

    scope = {
        "type": kind,
        "path": path,
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers],
    }
    asyncio.run(Guard(inner, 8090, "word")(scope, None, send))
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


def test_the_token_becomes_a_cookie_and_leaves_the_address() -> None:
    answer = _asked([OWN], path="//evil.example/x", query="token=word")
    headers = dict(answer["headers"])
    assert answer["status"] == 303
    assert headers[b"location"] == b"/evil.example/x"
    assert b"HttpOnly; SameSite=Strict" in headers[b"set-cookie"]
    assert _asked([OWN], query="token=wort")["status"] == 403
    assert _asked([("host", "evil.example")], query="token=word")["status"] == 403


@pytest.mark.parametrize("left", [True, False])
def test_an_answer_that_nobody_waits_for_is_no_error(left: bool) -> None:
    async def inner(scope, receive, send) -> None:
        await receive()
        raise RuntimeError("No response returned.")

    async def receive() -> dict:
        return {"type": "http.disconnect" if left else "http.request"}

    async def send(message) -> None:
        raise AssertionError(message)

    pairs = [(name.encode(), value.encode()) for name, value in (OWN, COOKIE)]
    scope = {"type": "http", "path": "/", "query_string": b"", "headers": pairs}
    asked = Guard(inner, 8090, "word")(scope, receive, send)
    if left:
        asyncio.run(asked)
    else:
        with pytest.raises(RuntimeError, match="No response"):
            asyncio.run(asked)
