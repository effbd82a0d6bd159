"""Headless Chromium on a page from disk, and all that the page says and asks for."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from playwright import sync_api

CHROMIUM = shutil.which("chromium")
# Marks of tests in a browser.
VISITS = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the path"),
]

ARGUMENTS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
# What Chromium says about its own speed when Plotly reads pixels back; nothing is wrong then.
BROWSERS_OWN = ("willReadFrequently", "GPU stall due to ReadPixels")


@contextmanager
def chromium() -> Iterator[sync_api.Browser]:
    """A browser of its own."""
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        yield browser
        browser.close()


class Visit:
    """A report opened from disk, with all that it said and asked for."""

    def __init__(self, browser, path: Path, width: int = 1280, scheme: str = "light") -> None:
        viewport = {"width": width, "height": 900}
        self.context = browser.new_context(viewport=viewport, color_scheme=scheme)
        self.page = self.context.new_page()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda message: self._hear(message.type, message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html.drawn", timeout=60_000, state="attached")

    def _hear(self, kind: str, text: str) -> None:
        harmless = any(known in text for known in BROWSERS_OWN)
        if kind in ("error", "warning") and not harmless:
            self.said.append(f"{kind}: {text}")

    def __enter__(self) -> "Visit":
        return self

    def __exit__(self, *_: object) -> None:
        self.context.close()

    def eventually(self, condition: Callable[[], bool]) -> bool:
        """Whether something becomes true within half a minute; drawing takes its time."""
        for _ in range(300):
            if condition():
                return True
            self.page.wait_for_timeout(100)
        return False

    def unfold(self) -> None:
        """Unfold all chapters and wait until their figures are drawn."""
        self.page.get_by_role("button", name="Unfold all").click()
        drawn = "document.querySelectorAll('.drawing').length == document.querySelectorAll("
        self.page.wait_for_function(f"{drawn}'.js-plotly-plot .main-svg:first-child').length")
        self.page.wait_for_selector("html.drawn", timeout=60_000, state="attached")

    def fits(self) -> bool:
        """Whether nothing makes the page wider than the window."""
        return self.page.evaluate(
            "document.scrollingElement.scrollWidth <= window.innerWidth && [...document"
            ".querySelectorAll('.js-plotly-plot')]"
            ".every((p) => p._fullLayout.width <= p.clientWidth + 1)"
        )

    def brightness(self, selector: str, style: str = "color") -> float:
        """Of a colour of the first such element, 0 to 255; NaN while it is being redrawn."""
        color = self.page.locator(selector).first.evaluate(
            "(element, style) => getComputedStyle(element)[style]", style
        )
        if "(" not in color:
            return float("nan")
        return float(np.mean([float(v) for v in color[color.index("(") + 1 : -1].split(",")[:3]]))
