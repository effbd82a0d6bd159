"""The live view of `deltaid show --live`: what it shows, whom it answers, how it ends."""

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from command import refused
from deltaid.errors import DeltaidError
from test_show import at_rest
from visit import CHROMIUM, chromium


def test_a_port_in_use_is_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        message = refused("show", "clavel-delta3", "--live", "--port", port, folder=tmp_path)
    assert f"--port {port}" in message
    assert "65535" in refused("show", "clavel-delta3", "--live", "--port", 99999, folder=tmp_path)
    idle = refused("show", "clavel-delta3", "--port", 8080, folder=tmp_path)
    assert "--port: has no effect without --live" in idle


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_ctrl_c_closes_the_live_view() -> None:
    code = "from deltaid.cli import main; main()"
    command = [sys.executable, "-u", "-c", code, "show", "clavel-delta3", "--live", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as shown:
        try:
            assert "clavel-delta3 is shown at http://127.0.0.1:" in shown.stdout.readline()
            time.sleep(1.0)  # its server runs by now
            shown.send_signal(signal.SIGINT)
            assert shown.wait(60) == 0
            assert "closed" in shown.stdout.read()
        finally:
            shown.kill()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the path")
def test_live_view_in_a_browser() -> None:
    from deltaid.view.live import LiveView

    live = LiveView(at_rest("irb360-6-1600"))
    try:
        with chromium() as browser:
            _visit(live, browser)
    finally:
        live.close()


def _visit(live, browser) -> None:
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    page.set_default_timeout(60_000)  # draws without a graphics card, beside other tests
    said, asked = [], []
    page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(live.url)
    page.get_by_text("use of the limits").wait_for()
    canvas = page.locator("canvas").first
    page.wait_for_timeout(1500)
    before = canvas.screenshot()

    live.move(live.robot.home + np.array([0.25, 0.1, 0.05, 0.5]))
    first = next(d for d in live.view.drives if d.name == "drive1")
    page.get_by_text(f"{first.position:.1f} deg").first.wait_for()
    page.wait_for_timeout(500)
    assert canvas.screenshot() != before
    arms = live.server.scene.get_handle_by_name("/robot/U")
    stood = arms.batched_positions.copy()

    live.move(live.robot.home + np.array([3.0, 0.0, 0.0, 0.0]))
    page.get_by_text("cannot reach").wait_for()
    np.testing.assert_array_equal(arms.batched_positions, stood)

    page.get_by_role("button", name="home").click()
    page.get_by_text("cannot reach").wait_for(state="detached")
    np.testing.assert_array_equal(live.view.z, live.robot.home)
    bodies = ("base", "U", "S", "P", "TU", "TL", "EE")
    names = (*(f"/robot/{body}" for body in bodies), "/workspace", "/target", "/reach")
    assert all(live.server.scene.get_handle_by_name(name) is not None for name in names)
    assert said == []
    assert all(url.startswith((live.url, f"blob:{live.url}")) for url in asked)


@pytest.fixture(scope="module")
def live():
    pytest.importorskip("viser")
    from deltaid.view.live import LiveView

    view = LiveView(at_rest("clavel-delta3"))
    yield view
    view.close()


def _socket(port: int, origin: str | None, **headers: str):
    """An attempt to open a websocket as a page of some origin would."""
    import viser
    from websockets.sync.client import connect

    return connect(
        f"ws://127.0.0.1:{port}",
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        additional_headers=headers,
        max_size=None,
    )


@pytest.mark.parametrize(
    "origin",
    ["https://evil.example", "http://evil.example:{port}", "http://127.0.0.1:1", "null", None,
     "http://127.0.0.1:{port}.evil.example", "https://127.0.0.1:{port}", "127.0.0.1:{port}"],
)  # fmt: skip
def test_live_view_talks_to_no_other_page(live, origin: str | None) -> None:
    from websockets.exceptions import InvalidStatus

    port = live.server.get_port()
    with pytest.raises(InvalidStatus, match="403"):
        _socket(port, origin and origin.format(port=port)).close()


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_live_view_talks_to_its_own_page(live, name: str) -> None:
    with _socket(live.server.get_port(), f"http://{name}:{live.server.get_port()}") as opened:
        assert opened.recv(timeout=60)


def test_live_view_shows_its_page_under_its_own_name_only(live) -> None:
    port = live.server.get_port()
    for host, status in ((f"127.0.0.1:{port}", 200), (f"localhost:{port}", 200),
                         (f"evil.example:{port}", 403), ("127.0.0.1:1", 403)):  # fmt: skip
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        connection.request("GET", "/", headers={"Host": host})
        assert connection.getresponse().status == status
        connection.close()


def test_a_viser_that_cannot_be_guarded_is_not_used() -> None:
    pytest.importorskip("viser")
    from deltaid.view.own_page import answering_own_page_only

    with pytest.raises(DeltaidError, match="this version of viser"), answering_own_page_only():
        pass
