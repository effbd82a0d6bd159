"""The studio by keyboard alone, with a recording of 10⁶ samples; and the picture in its docs.

    pip install '.[studio,test]'
    python benchmarks/studio.py [--samples 1000000] [--picture docs/images]

A recording of Clavel's Delta is written as another program would: names, degrees and milliseconds
of its own, torques four rows late and one of them with the other sign. In headless Chromium, with
no mouse, one goes from an empty folder to an exported model, a planned motion, a simulation and
forces: Tab until what is wanted has the focus, which has to be visible, and Enter. Meanwhile a
second client asks the server for a small file twenty times a second: how long it waits says how
fluid all other tabs are; the longest gap between two frames says it of this one. At last every
script of Python that the studio has shown is run in its folder, and compared by what it makes.
"""

import contextlib
import http.client
import sys
import tempfile
import threading
import time
from pathlib import Path

# The visitor and the recording are those of the tests.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
import polars as pl
from _table import STATED, leave
from _timing import options
from playwright import sync_api

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.robot.load import load_robot
from deltaid.studio.folder import Folder
from deltaid.studio.runs import runs
from foreign_logs import foreign
from studios import Studio
from visit import ARGUMENTS, CHROMIUM

ROBOT, LATE, TURNED = "clavel-delta3", 4, 2
_TABS = 400
_NAME = """() => {
  const e = document.activeElement, label = e.getAttribute('aria-label');
  const style = getComputedStyle(e), box = e.closest('.q-field__control');
  const seen = style.outlineStyle !== 'none' || style.boxShadow.includes('232, 162, 0') ||
    (box && getComputedStyle(box).boxShadow !== 'none');
  return [label || e.textContent.trim() || e.closest('label')?.textContent.trim() || '', !!seen];
}"""
_FRAMES = """() => { window.gaps = 0; let last = performance.now();
  const frame = (now) => { window.gaps = Math.max(window.gaps, now - last); last = now;
    requestAnimationFrame(frame); }; requestAnimationFrame(frame); }"""


def since(begun: float) -> str:
    return f"{time.perf_counter() - begun:.1f} s"


def recording(samples: int) -> pl.DataFrame:
    """A motion of Clavel's Delta with encoder steps and torque noise."""
    dynamics, rng = compiled(load_robot(ROBOT)), np.random.default_rng(5)
    motion = random_motion(dynamics.kinematics, rng, period=10.0)
    p = surrogate_parameters(dynamics.robot, rng)
    noise = SensorNoise(torque=0.02)
    return simulate_recording(dynamics, p, motion, rng, duration=samples / 1000, noise=noise)


class Pings(threading.Thread):
    """Asks for a small file again and again; how long it waits each time [ms]."""

    def __init__(self, studio: Studio) -> None:
        super().__init__(daemon=True)
        self.studio, self.waits, self.cookie = studio, list[float](), ""
        self.ended = threading.Event()

    def begin(self, page: sync_api.Page) -> None:
        """Ask as a page that has been let in."""
        self.cookie = "; ".join(f"{c['name']}={c['value']}" for c in page.context.cookies())
        self.start()

    def run(self) -> None:
        while not self.ended.wait(0.05):
            begun = time.perf_counter()
            connection = http.client.HTTPConnection("127.0.0.1", self.studio.port, timeout=60)
            try:
                connection.request("GET", "/files/studio.yaml", headers={"Cookie": self.cookie})
                connection.getresponse().read()
            except (ConnectionError, http.client.HTTPException):  # the server has been closed
                return
            self.waits.append(1e3 * (time.perf_counter() - begun))


class Keyboard:
    """A visitor without a mouse."""

    def __init__(self, page: sync_api.Page) -> None:
        self.page, self.steps, self.unseen = page, 0, set[str]()

    def reach(self, *names: str) -> None:
        """Tab until one of these has the focus."""
        for _ in range(_TABS):
            self.page.keyboard.press("Tab")
            self.steps += 1
            found, seen = self.page.evaluate(_NAME)
            is_body = "document.activeElement === document.body"
            if not seen and found and not self.page.evaluate(is_body):
                self.unseen.add(found[:40])
            if found in names:
                return
        raise SystemExit(f"no Tab leads to {names[0]}")

    def press(self, *names: str) -> None:
        """Tab there, then Enter."""
        self.reach(*names)
        self.page.keyboard.press("Enter")

    def see(self, text: str) -> None:
        self.page.get_by_text(text).first.wait_for(timeout=300_000)

    def go(self, stage: str) -> None:
        link = self.page.get_by_role("navigation").get_by_role("link", name=stage)
        self.press(link.get_attribute("aria-label") or "")
        self.page.wait_for_url(f"**/{stage.lower()}")
        self.page.get_by_role("heading", level=1, name=stage).wait_for()
        self.page.wait_for_timeout(500)


def visit(page: sync_api.Page, pings: Pings, log: Path, table: list[tuple[str, str]]) -> None:
    keys = Keyboard(page)
    begun = time.perf_counter()
    page.goto(pings.studio.address)
    pings.begin(page)
    page.get_by_role("combobox", name="Robot").wait_for()
    table.append(("from the address to the first page", since(begun)))
    keys.reach("Robot")
    page.keyboard.type(ROBOT)
    page.get_by_role("option", name=ROBOT).wait_for()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.get_by_text("Edit a copy of it").wait_for()
    keys.press("Edit a copy of it")
    keys.see("Describe it")
    keys.go("Recording")
    with page.expect_file_chooser() as chooser:
        keys.press("Choose a recording")
    begun = time.perf_counter()
    page.evaluate(_FRAMES)
    chooser.value.set_files(log)
    keys.see("so degrees are assumed")
    table.append(("from the drop to proposed columns", since(begun)))
    page.locator(".js-plotly-plot").wait_for(timeout=300_000)
    table.append(("… to the preview", since(begun)))
    keys.press("Use these, write mapping.yaml")
    keys.see("Kept in mapping.yaml")
    page.locator(".js-plotly-plot .main-svg").first.wait_for(timeout=300_000)
    zoom(page, table)
    table.append(("longest gap between two frames", f"{page.evaluate('gaps'):.0f} ms"))
    keys.go("Check")
    begun = time.perf_counter()
    keys.press("Check")
    keys.see("Something is wrong")
    keys.press("Show the change to the mapping for torque-sign")
    page.get_by_text("sign: -1").wait_for()
    keys.press("Apply")
    keys.see("have changed since the last check")
    keys.press("Check")
    keys.see("torque-lag")
    table.append(("two checks and a cure", since(begun)))
    keys.go("Fit")
    begun = time.perf_counter()
    keys.press("Fit")
    page.get_by_role("button", name="See the result").wait_for(timeout=300_000)
    table.append(("fit and its report", since(begun)))
    keys.press("See the result")
    keys.see("fits torques")
    keys.go("Use")
    for step in ("Export", "Excite", "Simulate", "Forces"):
        keys.press(step)
        page.get_by_text(f"-{step.lower()}:").wait_for(timeout=300_000)  # what it made
        page.wait_for_timeout(500)
    table.append(("keys pressed to get about", f"{keys.steps} Tabs"))
    table.append(("focus not visible on", ", ".join(sorted(keys.unseen)) or "nothing"))


def zoom(page: sync_api.Page, table: list[tuple[str, str]]) -> None:
    """Look at two seconds of the preview; count what is drawn before and then."""
    drawn = "document.querySelector('.js-plotly-plot').calcdata[0]"
    points, spacing = f"{drawn}.length", f"({drawn}[9].x - {drawn}[0].x)"
    table.append(("points of a curve that is drawn", f"{page.evaluate(points):.0f}"))
    before, begun = page.evaluate(spacing), time.perf_counter()
    page.evaluate(
        "() => import('nicegui-plotly').then(({Plotly}) => Plotly.relayout("
        "document.querySelector('.js-plotly-plot'), {'xaxis.range[0]': 10, 'xaxis.range[1]': 12}))"
    )
    page.wait_for_function(f"{spacing} < {before / 3}", timeout=60_000)
    table.append(("two seconds in full detail", since(begun)))


def memory(pid: int) -> str:
    """Most memory that the server has had, and most of what it has started and is there [MB]."""
    found: dict[int, tuple[int, int]] = {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, KeyError):  # processes come and go
            lines = (place / "status").read_text().splitlines()
            said = dict(line.split(":", 1) for line in lines)
            found[int(place.name)] = int(said["PPid"]), int(said["VmHWM"].split()[0])
    below = [most for parent, most in found.values() if parent == pid]
    return f"{found[pid][1] / 1e3:.0f} and {max(below, default=0) / 1e3:.0f} MB"


def scripts(work: Path, table: list[tuple[str, str]]) -> None:
    for run in reversed(runs(Folder.open(work))):
        if not run.succeeded:
            raise SystemExit(f"{run.name} failed: {run.command}")
        begun = time.perf_counter()
        with contextlib.chdir(work), contextlib.redirect_stdout(None):
            exec(compile(run.python, run.name, "exec"), {})
        table.append((f"Python of {run.name}", since(begun)))


def pictures(browser: sync_api.Browser, studio: Studio, folder: Path) -> None:
    """Two stages, as the docs show them."""
    page = browser.new_page(viewport={"width": 1280, "height": 760})
    page.goto(studio.address)
    page.goto(f"{studio.base}/robot")
    live = page.locator(".live")
    live.get_by_text("use of the limits").wait_for()
    page.wait_for_timeout(2000)
    page.locator(".live .q-slider__track-container").last.focus()
    for _ in range(45):
        page.keyboard.press("ArrowLeft")
    page.evaluate("document.querySelector('.live').closest('.panel').scrollIntoView()")
    page.wait_for_timeout(1500)
    page.screenshot(path=folder / "studio-robot.png")
    page.goto(f"{studio.base}/recording")
    page.locator(".js-plotly-plot .main-svg").first.wait_for(timeout=300_000)
    zoom(page, [])
    page.wait_for_timeout(1500)
    page.screenshot(path=folder / "studio-recording.png", full_page=True)


def main() -> None:
    given = options(__doc__, samples=STATED["studio"]["samples"], picture=Path)
    table: list[tuple[str, str]] = [("samples", f"{given.samples:,}".replace(",", " "))]
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        work = place / "my-robot"
        log = foreign(place / "axes.csv", recording(given.samples), late=LATE, turned=TURNED)
        table.append(("recording", f"{log.stat().st_size / 1e6:.0f} MB of CSV"))
        begun = time.perf_counter()
        with Studio(work) as studio, sync_api.sync_playwright() as playwright:
            table.append(("from the command to its address", since(begun)))
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.set_default_timeout(60_000)
            asked: list[str] = []
            page.on("request", lambda request: asked.append(request.url))
            page.on("websocket", lambda socket: asked.append(socket.url))
            pings = Pings(studio)
            visit(page, pings, log, table)
            pings.ended.set()
            waits = np.array(pings.waits)
            table.append(("server: usual and longest wait of another tab",
                          f"{np.median(waits):.0f} and {waits.max():.0f} ms"))  # fmt: skip
            table.append(("memory: server, its process for files at most", memory(studio.pid)))
            own = (studio.base, studio.base.replace("http:", "ws:"), "data:", "blob:")
            foreigners = [url for url in asked if not url.startswith(own)]
            table.append((f"of {len(asked)} requests left the machine", str(len(foreigners))))
            if given.picture:
                pictures(browser, studio, given.picture)
            browser.close()
        scripts(work, table)
    leave(("what", "measured"), table, "The studio by keyboard alone.", samples=given.samples)


if __name__ == "__main__":
    main()
