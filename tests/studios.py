"""A studio in a process of its own, and its visitors."""

import os
import queue
import re
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from visit import BROWSERS_OWN, chromium

SOURCE = Path(__file__).parents[1] / "src"
ENTRY = "from deltaid.cli import main; main()"


class Studio:
    """`deltaid studio FOLDER`, until it is closed."""

    def __init__(self, folder: Path) -> None:
        # NiceGUI behaves in another way where it sees a test.
        plain = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
        environment = plain | {"PYTHONPATH": str(SOURCE), "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", ENTRY, "studio", str(folder), "--port", "0", "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            text=True,
        )
        said = self._process.stdout.readline()
        found = re.search(r"(http://127\.0\.0\.1:(\d+))/\?key=(\S+)", said)
        assert found, said + self.errors()
        self.base, self.port = found[1], int(found[2])
        self._addresses: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._addresses.put(found[0])
        self._said: list[str] = []
        self._readers = [threading.Thread(target=f, daemon=True) for f in (self._read, self._hear)]
        for reader in self._readers:
            reader.start()

    @property
    def address(self) -> str:
        """What opens it once: the next one that it has printed."""
        return self._addresses.get(timeout=60)

    def _read(self) -> None:
        assert self._process.stderr is not None
        self._said += self._process.stderr

    def _hear(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if found := re.search(r"http://127\S+", line):
                self._addresses.put(found[0])

    def errors(self) -> str:
        """What it has said on standard error; read when it has ended."""
        return "".join(getattr(self, "_said", []))

    def close(self) -> None:
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(60)
        except subprocess.TimeoutExpired:
            self._process.kill()
        for reader in self._readers:
            reader.join(5)

    def __enter__(self) -> "Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# What Plotly says of a figure that is taken away while it is drawn.
_HARMLESS = ("Resize must be passed a displayed plot div element",)


class Visitor:
    """A browser with some tabs of the studio, all that these said, and whom they asked."""

    def __init__(self, browser, studio: Studio) -> None:
        self.studio = studio
        self.context = browser.new_context(viewport={"width": 1280, "height": 900})
        self.context.set_default_timeout(40_000)
        self.said: list[str] = []
        self.asked: list[str] = []
        self.context.on("request", lambda request: self.asked.append(request.url))
        self.page = self.tab(studio.address)

    def tab(self, address: str):
        page = self.context.new_page()
        page.on("console", lambda message: self._hear(message.type, message.text))
        page.on("pageerror", lambda error: self._hear("error", str(error)))
        page.on("websocket", lambda socket: self.asked.append(socket.url))
        page.goto(address)
        page.get_by_role("heading", level=1).wait_for()
        return page

    @property
    def others(self) -> list[str]:
        """What was asked of anything but the studio."""
        base = self.studio.base
        own = (base, base.replace("http:", "ws:"), "data:", "blob:")
        return [url for url in self.asked if not url.startswith(own)]

    def _hear(self, kind: str, text: str) -> None:
        if kind in ("error", "warning") and not any(
            harmless in text for harmless in (*BROWSERS_OWN, *_HARMLESS)
        ):
            self.said.append(f"{kind}: {text}")

    def go(self, stage: str) -> None:
        """To a stage, and there once more, as a reload does."""
        self.page.get_by_role("navigation").get_by_role("link", name=stage).click()
        self.page.wait_for_url(f"**/{stage.lower()}")
        self.page.get_by_role("heading", level=1, name=stage).wait_for()
        self.page.reload()
        self.page.get_by_role("heading", level=1, name=stage).wait_for()

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, recording: Path) -> None:
        """Give the page a recording from disk."""
        with self.page.expect_file_chooser() as chooser:
            self.press("Choose a recording")
        chooser.value.set_files(recording)

    def see(self, text: str, page=None) -> None:
        (page or self.page).get_by_text(text).first.wait_for()

    def copied(self) -> tuple[list[str], str]:
        """The command and the Python that this stage shows."""
        self.page.get_by_text("Command line and Python of this step").last.click()
        command = self.page.locator("pre.command:visible").last.inner_text()
        python = self.page.locator("pre.python:visible").last.inner_text()
        return shlex.split(command), python


@contextmanager
def visited(folder: Path) -> Iterator[Visitor]:
    """A visitor of a folder's studio; in the end nothing was wrong, and nobody else was asked."""
    with Studio(folder) as studio, chromium() as browser:
        visitor = Visitor(browser, studio)
        yield visitor
        assert visitor.said == [], visitor.said
        assert visitor.others == []
    assert "Traceback" not in studio.errors()
