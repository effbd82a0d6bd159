"""`deltaid show`: readings equal kinematics, reach ends at limits, page, errors, live view."""

import http.client
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from playwright import sync_api

from command import refused, run
from deltaid import libraries
from deltaid.dynamics.at_rest import AtRest
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError
from deltaid.model.model import load
from deltaid.robot.load import load_robot
from deltaid.show.page import percent_of, robot_page
from deltaid.show.reach import good, reach, survey
from deltaid.show.shapes import along, cylinder
from deltaid.show.view import home_view, moved

ROBOTS = ("clavel-delta3", "irb360-6-1600")


@cache
def at_rest(name: str) -> AtRest:
    found = load(name)
    return AtRest(found.dynamics, found.p)


@pytest.mark.parametrize("name", ROBOTS)
def test_readings_are_those_of_kinematics_and_dynamics(name: str) -> None:
    robot, rng = at_rest(name), np.random.default_rng(0)
    z = robot.home + rng.uniform(-0.15, 0.15, (50, robot.dynamics.dof))
    poses, kinematics = robot(z), robot.dynamics.kinematics
    still = np.zeros_like(z)
    assert poses.stands.all()
    np.testing.assert_allclose(poses.q, kinematics.inverse(z), rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.condition, kinematics.condition(z), rtol=1e-12)
    torque = robot.dynamics.torque(z, still, still, robot.p)
    np.testing.assert_allclose(poses.torque, torque, rtol=0, atol=1e-10)
    limits = robot.robot.drive_limits["drive2"]
    low, high = limits.range
    used = np.abs(poses.q[:, 1] - 0.5 * (low + high)) / (0.5 * (high - low))
    np.testing.assert_allclose(poses.shares[:, robot.limits.index("drive2 angle")], used)
    effort = poses.shares[:, robot.limits.index("drive2 torque")]
    np.testing.assert_allclose(effort, np.abs(torque[:, 1]) / limits.torque, atol=1e-12)


def test_out_of_reach_the_robot_stays_and_says_why() -> None:
    robot = at_rest("clavel-delta3")
    view = moved(robot, home_view(robot), np.array([0.1, 0.2, -1.0]))
    assert view.arrived
    assert view.message == ""
    asked = np.array([0.1, 0.2, -3.0])
    stayed = moved(robot, view, asked)
    asked[:] = 0  # views keep no one else's array
    assert not stayed.arrived
    np.testing.assert_array_equal(stayed.z, [0.1, 0.2, -1.0])
    np.testing.assert_array_equal(stayed.wanted, [0.1, 0.2, -3.0])
    assert stayed.drives == view.drives
    assert "limb 1 cannot reach" in stayed.message
    assert "stays" in stayed.message
    again = moved(robot, stayed, np.array([0.0, 0.0, -1.0]))
    assert again.arrived
    assert again.message == ""
    assert "no number" in moved(robot, again, np.array([np.nan, 0.0, -1.0])).message


def test_a_pose_beyond_limits_is_shown_and_they_are_named() -> None:
    robot = at_rest("clavel-delta3")
    view = moved(robot, home_view(robot), np.array([-0.75, 0.0, -1.0]))
    assert view.arrived
    over = {limit.name for limit in view.limits if limit.state == "over"}
    assert "workspace radius" in over
    assert view.message == "beyond " + ", ".join(n for n in robot.limits if n in over)
    assert all((limit.share > 1) == (limit.state == "over") for limit in view.limits)
    assert [limit.name for limit in view.limits] == list(robot.limits)


@pytest.mark.parametrize("name", ROBOTS)
def test_ways_end_where_a_limit_does(name: str) -> None:
    robot = at_rest(name)
    found = reach(robot)
    unit = found.points - robot.home[:3]
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    rows = found.distance.size
    z = np.tile(robot.home, (rows, 1))
    z[:, :3] = found.points.reshape(-1, 3)
    inside = robot(z)
    assert good(robot, inside).all()
    ended_by = found.ended_by.ravel()
    fullest = inside.shares[np.arange(rows), ended_by]
    np.testing.assert_allclose(fullest, 1.0, atol=1e-4)
    z[:, :3] += 1e-5 * unit.reshape(-1, 3)
    assert not good(robot, robot(z)).any()
    assert sum(found.shares.values()) == pytest.approx(1.0)


def test_volume_is_that_of_points_inside() -> None:
    robot = at_rest("clavel-delta3")
    found, rng = reach(robot), np.random.default_rng(1)
    points = found.points.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    inside = good(robot, robot(rng.uniform(low, high, (200_000, 3)))).mean()
    assert found.volume == pytest.approx(inside * np.prod(high - low), rel=0.03)


def test_limits_that_cut_the_workspace_are_warned_of() -> None:
    described = load_robot("clavel-delta3")
    tight = {**described.drive_limits}
    tight["drive1"] = tight["drive1"].changed(angle_deg=(0.0, 30.0))
    robot = described.changed(drive_limits=tight)
    rest = AtRest(compiled(robot), prior_parameters(robot))
    surveyed = survey(rest)
    z = surveyed.poses.z
    turned = np.rad2deg(rest.dynamics.kinematics.inverse(z)[:, 0])
    assert 0 < surveyed.within < 1
    assert surveyed.within == pytest.approx(np.mean((turned >= 0) & (turned <= 30)), abs=0.02)
    page = robot_page(rest, reach(rest), surveyed, "")
    (warning,) = page.warnings
    assert warning.startswith(
        f"{percent_of(1 - surveyed.within)} of the described workspace cannot be used; likeliest "
        "cause: poses lie beyond drive1 angle; "
    )


def test_cylinders_join_the_ends_of_segments() -> None:
    rng = np.random.default_rng(2)
    segments = rng.uniform(-1, 1, (20, 2, 3))
    segments[0, 1] = segments[0, 0] - [0, 0, 0.5]  # straight down
    segments[1, 1] = segments[1, 0]  # no length
    placed, mesh = along(segments, 0.01), cylinder()
    w, v = placed.wxyz[:, :1], placed.wxyz[:, 1:]
    half = np.array([0, 0, 0.5]) * placed.scales
    turned = half + 2 * np.cross(v, np.cross(v, half) + w * half)
    np.testing.assert_allclose(placed.positions + turned, segments[:, 1], atol=1e-8)
    np.testing.assert_allclose(placed.positions - turned, segments[:, 0], atol=1e-8)
    a, b, c = (mesh.corners[mesh.triangles[:, k]] for k in range(3))
    sides = np.einsum("ti,ti->t", np.cross(b - a, c - a), a + b + c)
    assert (sides > 0).all()  # all face outwards


def test_page_and_tables(tmp_path: Path) -> None:
    printed = run("show", "irb360-6-1600")
    assert printed.code == 0
    for text in ("condition in the workspace", "telescope length", "at x, y, z [m]", "-50 … 80"):
        assert text in printed.out
    path = tmp_path / "robot.html"
    assert run("show", "irb360-6-1600", "-o", path).code == 0
    page = path.read_text(encoding="utf-8")
    for text in ("ends at: strut swing", "Nothing ends the turning", "prior parameters"):
        assert text in page


def test_a_model_is_shown_with_its_own_parameters(tmp_path: Path) -> None:
    assert run("demo", "clavel-delta3", "--keep", tmp_path).code == 0
    found = load(str(tmp_path / "model.yaml"))
    assert found.origin.startswith("identified from")
    model, prior = AtRest(found.dynamics, found.p), at_rest("clavel-delta3")
    assert np.abs(model(model.home[None]).torque - prior(prior.home[None]).torque).max() > 0.01


def test_errors_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "must end in .html" in refused("show", "clavel-delta3", "-o", "a.png", folder=tmp_path)
    assert "clavel-delta3" in refused("show", "clavel", folder=tmp_path)
    monkeypatch.setattr(libraries, "find_spec", lambda _: None)
    message = refused("show", "clavel-delta3", "--live", folder=tmp_path)
    assert "pip install viser" in message


def test_a_port_in_use_is_refused(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        message = refused("show", "clavel-delta3", "--live", "--port", port, folder=tmp_path)
    assert f"--port {port}" in message
    assert "65535" in refused("show", "clavel-delta3", "--live", "--port", 99999, folder=tmp_path)


def test_help_does_not_load_viser() -> None:
    code = "import sys, deltaid.cli.app; sys.exit('viser' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_ctrl_c_closes_the_live_view() -> None:
    code = "from deltaid.cli import main; main()"
    command = [sys.executable, "-u", "-c", code, "show", "clavel-delta3", "--live", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as shown:
        try:
            assert "clavel-delta3 is shown at http://127.0.0.1:" in shown.stdout.readline()
            time.sleep(1.0)  # its server runs by now
            shown.send_signal(signal.SIGINT)
            assert shown.wait(20) == 0
            assert "closed" in shown.stdout.read()
        finally:
            shown.kill()


def test_live_view_in_a_browser() -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("there is no chromium on the path")
    from deltaid.show.live import LiveView

    live = LiveView(at_rest("irb360-6-1600"))
    try:
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=list(_ARGUMENTS))
            try:
                _visit(live, browser)
            finally:
                browser.close()
    finally:
        live.close()


_ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip


def _visit(live, browser) -> None:
    page = browser.new_page(viewport={"width": 1000, "height": 700})
    said, asked = [], []
    page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(live.url)
    page.get_by_text("use of the limits").wait_for(timeout=15_000)
    canvas = page.locator("canvas").first
    page.wait_for_timeout(1500)
    before = canvas.screenshot()

    live.move(live.robot.home + np.array([0.25, 0.1, 0.05, 0.5]))
    first = next(d for d in live.view.drives if d.name == "drive1")
    page.get_by_text(f"{first.position:.1f} deg").first.wait_for(timeout=5000)
    page.wait_for_timeout(500)
    assert canvas.screenshot() != before
    arms = live.server.scene.get_handle_by_name("/robot/U")
    assert arms is not None
    stood = arms.batched_positions.copy()

    live.move(live.robot.home + np.array([3.0, 0.0, 0.0, 0.0]))
    page.get_by_text("cannot reach").wait_for(timeout=5000)
    np.testing.assert_array_equal(arms.batched_positions, stood)

    page.get_by_role("button", name="home").click()
    page.get_by_text("cannot reach").wait_for(state="detached", timeout=5000)
    np.testing.assert_array_equal(live.view.z, live.robot.home)
    bodies = ("base", "U", "S", "P", "TU", "TL", "EE")
    names = (*(f"/robot/{body}" for body in bodies), "/workspace", "/target", "/reach")
    assert all(live.server.scene.get_handle_by_name(name) is not None for name in names)
    assert said == []
    assert all(url.startswith((live.url, f"blob:{live.url}")) for url in asked)


@pytest.fixture(scope="module")
def live():
    pytest.importorskip("viser")
    from deltaid.show.live import LiveView

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
        assert opened.recv(timeout=10)


def test_live_view_shows_its_page_under_its_own_name_only(live) -> None:
    port = live.server.get_port()
    for host, status in ((f"127.0.0.1:{port}", 200), (f"localhost:{port}", 200),
                         (f"evil.example:{port}", 403), ("127.0.0.1:1", 403)):  # fmt: skip
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/", headers={"Host": host})
        assert connection.getresponse().status == status
        connection.close()


def test_a_viser_that_cannot_be_guarded_is_not_used() -> None:
    pytest.importorskip("viser")
    from deltaid.show.own_page import answering_own_page_only

    with pytest.raises(DeltaidError, match="this version of viser"), answering_own_page_only():
        pass
