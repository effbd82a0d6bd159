"""The studio in headless Chromium: from an empty folder to an exported model, offline."""

import http.client
import shlex
import xml.etree.ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltaid.model.model import load
from deltaid.studio.folder import Folder
from deltaid.studio.runs import runs
from foreign_logs import foreign
from logs import recorded
from studios import Studio, Visitor, visited
from visit import VISITS

pytestmark = VISITS
LATE, TURNED = 4, 2


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the studio's folder will be, and beside it a recording with two faults."""
    folder = tmp_path_factory.mktemp("studio")
    foreign(folder / "axes.csv", recorded(3000), late=LATE, turned=TURNED)
    return folder


@pytest.fixture(scope="module")
def visitor(place: Path) -> Iterator[Visitor]:
    with visited(place / "work") as found:
        yield found


def test_from_an_empty_folder_to_an_exported_model(visitor: Visitor, place: Path) -> None:
    page, work = visitor.page, place / "work"
    # Robot: out of the catalogue, edited; what is wrong is said and not saved.
    page.get_by_role("combobox", name="Robot").fill("clavel")
    page.get_by_role("option", name="clavel-delta3").click()
    visitor.press("Edit a copy of it")
    visitor.see("Describe it: clavel-delta3.yaml")
    page.reload()
    visitor.see("Describe it: clavel-delta3.yaml")
    page.locator(".cm-content").click()
    page.keyboard.press("Control+Home")
    page.keyboard.type("strutt: 1\n")
    visitor.see("strutt")
    page.get_by_role("alert").get_by_text("line 1").wait_for()
    visitor.press("Undo all")
    # Recording: dropped; a second tab sees what happens in the first one.
    visitor.go("Recording")
    visitor.choose(place / "axes.csv")
    visitor.see("so degrees are assumed")
    other = visitor.tab(f"{visitor.studio.base}/recording")
    assert not (work / "mapping.yaml").exists()
    visitor.press("Use these, write mapping.yaml")
    visitor.see("Kept in mapping.yaml", other)
    page.reload()
    page.locator(".js-plotly-plot").wait_for()
    assert (work / "axes.csv").read_bytes() == (place / "axes.csv").read_bytes()
    # Fit: not before a check.
    visitor.go("Fit")
    assert page.get_by_role("button", name="Fit", exact=True).is_disabled()
    # Check: what is wrong is mended by a click, after its diff.
    visitor.go("Check")
    visitor.press("Check")
    visitor.see("Something is wrong")
    before = (work / "mapping.yaml").read_text()
    page.get_by_role("button", name="Show the change to the mapping").click()
    visitor.see("+- {column: Axis2.ActTorque, unit: N m, sign: -1}")
    assert (work / "mapping.yaml").read_text() == before
    visitor.press("Apply")
    visitor.see("have changed since the last check")
    other.locator(".q-select", has=other.get_by_label("torque of drive2: sign")).get_by_text(
        "−"
    ).wait_for()
    visitor.go("Check")
    check = visitor.copied()
    visitor.press("Check")
    visitor.see("torque-lag")
    # Fit, and its result in words and figures.
    visitor.go("Fit")
    visitor.press("Fit")
    visitor.press("Cancel")
    visitor.see("Cancelled: nothing was written.")
    assert not list(work.glob("runs/*/model.yaml"))
    fit = visitor.copied()
    visitor.press("Fit")
    page.reload()
    visitor.press("See the result")
    visitor.see("Untested: fits torques of its own recording within")
    visitor.go("Result")
    page.frame_locator("iframe").locator("html.drawn").wait_for(state="attached")
    visitor.see("error, as a share of the torque")
    page.locator(".js-plotly-plot .main-svg").first.wait_for()
    visitor.go("Use")
    page.get_by_role("link", name="axes.csv").wait_for()
    export = page.get_by_role("button", name="Export", exact=True)
    export.click()
    page.get_by_role("link", name="clavel_delta3.xml").wait_for()
    done = {run.kind: run for run in reversed(runs(Folder.open(work)))}
    xml.etree.ElementTree.parse(work / done["export"].file("clavel_delta3.xml"))
    # The lag was found and put right, and nothing of it all left this machine.
    model = load(work / done["fit"].file("model.yaml")).identified
    (lag,) = [correction for correction in model.corrections if correction.kind == "lag"]
    assert abs(1e3 * lag.value - LATE) < 0.3 or abs(lag.value - LATE) < 0.3
    assert any(url.startswith("ws:") for url in visitor.asked)
    # What was shown is what ran; that its Python does the same is a test of its own.
    for shown, kind in ((check, "check"), (fit, "fit")):
        assert shown[0] == shlex.split(done[kind].command)
        assert shown[1].split() == done[kind].python.split()


def _ask(studio: Studio, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", studio.port, timeout=60)
    connection.request("GET", path, headers={k.replace("_", "-"): v for k, v in headers.items()})
    return connection.getresponse()


def test_nobody_else_is_answered(visitor: Visitor) -> None:
    studio = visitor.studio
    path = studio.address.removeprefix(studio.base)
    cookie = _ask(studio, path).headers["set-cookie"].partition(";")[0]
    assert _ask(studio, path).status == 403  # a key opens it once
    own = f"http://127.0.0.1:{studio.port}"
    files = "/files/studio.yaml"
    socket = "/_nicegui_ws/socket.io/?EIO=4&transport=polling"
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec_WebSocket_Version": "13",
               "Sec_WebSocket_Key": "x3JJHMbDL1EzLkh9GBhXDw=="}  # fmt: skip
    assert _ask(studio, files, Cookie=cookie).status == 200
    assert _ask(studio, files).status == 403
    assert _ask(studio, files, Cookie=cookie, Host="evil.example").status == 403
    assert _ask(studio, files, Cookie=cookie, Origin="http://evil.example").status == 403
    assert _ask(studio, socket, Cookie=cookie, Origin="http://evil.example").status == 403
    websocket = socket.replace("polling", "websocket")
    assert _ask(studio, websocket, Cookie=cookie, Origin=own, **upgrade).status == 101
    assert _ask(studio, websocket, Cookie=cookie, Origin="http://evil", **upgrade).status == 403
    assert _ask(studio, websocket, Origin=own, **upgrade).status == 403
    for name in ("../axes.csv", "%2e%2e/axes.csv", "..%2faxes.csv", "/etc/passwd", ".hidden"):
        assert _ask(studio, f"/files/{name}", Cookie=cookie).status == 404
