"""The pictures of README, docs/gallery.md and docs/export.md, made by the program itself.

    pip install -e '.[test]'
    python benchmarks/pictures.py

writes into docs/images. Pages are photographed in Chromium, in light and in dark colours; the
terminal is an SVG that plays by itself, written by `recorded_terminal`.
"""

import html
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
from PIL import Image
from playwright import sync_api
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from rich.terminal_theme import DIMMED_MONOKAI as THEME
from rich.text import Text

from deltaid.exports.mjcf import mjcf
from deltaid.model.model import load

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
ROBOTS = ("irb360-6-1600", "h4", "par4-linear", "linear-delta")
COLUMNS, ROWS = 100, 27
_CELL, _LINE, _TOP = 8.4, 19, 44  # px
_TYPING, _THINKING, _READING, _END = 1.0, 0.4, 2.6, 2.0  # s
_WAITING = re.compile("[\u2800-\u28ff━] ?")  # what turns or grows while something is computed
_SOMETHING_WRONG = 4  # exit code of deltaid check
_STYLE = f"""
text {{ font: 14px/{_LINE}px ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace;
  fill: #d9d9d9; white-space: pre; }}
.line {{ visibility: hidden; }}
"""


@dataclass(frozen=True)
class Shown:
    """A command, and of its output the first and last lines that are shown; all if neither."""

    command: str
    first: int = 0
    last: int = 0

    def lines(self, folder: Path) -> list[Text]:
        """Run it; what stands in a terminal when it has ended.

        Raises:
            subprocess.CalledProcessError: If it ends with an error; a check may find something.
        """
        environment = os.environ | {"FORCE_COLOR": "1", "COLUMNS": str(COLUMNS)}
        done = subprocess.run(
            shlex.split(self.command), cwd=folder, capture_output=True, text=True, env=environment
        )
        if done.returncode not in (0, _SOMETHING_WRONG):
            done.check_returncode()
        texts = [Text.from_ansi(line) for line in (done.stderr + done.stdout).splitlines()]
        printed = [text for text in texts if not _WAITING.match(text.plain)]
        while printed and not printed[0].plain.strip():
            del printed[0]
        if len(printed) <= (self.first + self.last or len(printed)):
            return printed
        end = printed[len(printed) - self.last :]
        return [*printed[: self.first], Text("…", style="dim"), *end]


def recorded_terminal(session: tuple[Shown, ...], folder: Path) -> str:
    """The SVG of a session in a folder; it starts again when it has ended."""
    console = Console(width=COLUMNS, color_system="truecolor", force_terminal=True)
    rows: list[tuple[float, bool, list[Segment]]] = []  # when, whether typed, what
    now = 0.5
    for shown in session:
        prompt = Text.assemble(("$ ", "bold green"), (shown.command, "bold"))
        wrapped = console.render_lines(prompt, pad=False)
        for line in wrapped:
            rows.append((now, True, line))
            now += _TYPING / len(wrapped)
        now += _THINKING
        for text in shown.lines(folder):
            for line in console.render_lines(text, pad=False):
                rows.append((now, False, line))
                now += 0.02
        rows.append((now, False, []))
        now += _READING
    return _svg(rows, now + _END)


def _svg(rows: list[tuple[float, bool, list[Segment]]], total: float) -> str:
    width, height = round(COLUMNS * _CELL + 32), _TOP + ROWS * _LINE + 16
    lines = "\n".join(_row(i, row, total) for i, row in enumerate(rows))
    scroll = "".join(
        f"{100 * when / total:.2f}% {{ transform: translateY({-_LINE * max(0, i + 1 - ROWS)}px) }}"
        for i, (when, _, _) in enumerate(rows)
    )
    end = f"100% {{ transform: translateY({-_LINE * max(0, len(rows) - ROWS)}px) }}"
    dots = "".join(
        f'<circle cx="{20 + 18 * i}" cy="20" r="6" fill="{color}"/>'
        for i, color in enumerate(("#ff5f57", "#febc2e", "#28c840"))
    )
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img"
  aria-label="A terminal: deltaid checks a log, identifies a model and uses it">
<style>{_STYLE}
.all {{ animation: scroll {total:.1f}s step-end infinite; }}
@keyframes scroll {{ {scroll} {end} }}
@media (prefers-reduced-motion: reduce) {{
  .line, .all {{ animation: none !important; }} .line {{ visibility: visible; }}
  .all {{ transform: translateY({-_LINE * max(0, len(rows) - ROWS)}px); }} }}
</style>
<rect x=".5" y=".5" width="{width - 1}" height="{height - 1}" rx="8" fill="#191919" stroke="#555"/>
{dots}
<svg x="16" y="{_TOP - 8}" width="{width - 32}" height="{ROWS * _LINE + 8}"><g class="all">
{lines}
</g></svg></svg>
"""


def _row(i: int, row: tuple[float, bool, list[Segment]], total: float) -> str:
    when, typed, segments = row
    start = 100 * when / total
    if typed:
        done = start + 100 * _TYPING / total / 2
        letters = max(1, sum(len(segment.text) for segment in segments))
        frames = (
            f"0%, {start - 0.01:.2f}% {{ visibility: hidden; clip-path: inset(0 100% 0 0);"
            f" animation-timing-function: step-end }}"
            f" {start:.2f}% {{ visibility: visible; clip-path: inset(0 100% 0 0);"
            f" animation-timing-function: steps({letters}) }}"
            f" {done:.2f}%, 100% {{ visibility: visible; clip-path: inset(0 0 0 0) }}"
        )
    else:
        frames = (
            f"0%, {start - 0.01:.2f}% {{ visibility: hidden }}"
            f" {start:.2f}%, 100% {{ visibility: visible }}"
        )
    style = f"<style>@keyframes r{i} {{ {frames} }}</style>"
    spans, column = "", 0
    for segment in segments:
        spans += _span(segment, column)
        column += segment.cell_length
    baseline = _LINE * i + 15
    animation = f"animation: r{i} {total:.1f}s linear infinite"
    return f'{style}<text class="line" y="{baseline}" style="{animation}">{spans}</text>'


def _span(segment: Segment, column: int) -> str:
    if not segment.text.strip():
        return ""
    style = segment.style or Style()
    color = style.color.get_truecolor(THEME) if style.color else None
    look = f' fill="{color.hex}"' if color else ""
    look += ' font-weight="bold"' if style.bold else ""
    look += ' opacity="0.6"' if style.dim else ""
    length = f' textLength="{segment.cell_length * _CELL:.1f}" lengthAdjust="spacing"'
    return f'<tspan x="{column * _CELL:.1f}"{length}{look}>{html.escape(segment.text)}</tspan>'


SESSION = (
    Shown("deltaid check demo/robot.yaml log.csv --columns columns.yaml --write mended.yaml"),
    Shown(
        "deltaid identify demo/robot.yaml log.csv --columns mended.yaml "
        "--verify other-log.csv -o model.yaml --report report.html"
    ),
    Shown(
        "deltaid forces model.yaml planned.csv --columns planned.yaml --strut-spacing 0.1", first=13
    ),
    Shown("deltaid torque model.yaml planned.csv --columns planned.yaml -o feed-forward.csv"),
)


def prepare(folder: Path) -> None:
    """The demonstration's robot and recordings, and the logs of a foreign controller."""
    for path in (ROOT / "examples" / "foreign_log").iterdir():
        shutil.copy(path, folder)
    for command in (
        ["deltaid", "demo", "--keep", "demo"],
        [sys.executable, "make.py"],
        [sys.executable, "planned.py"],
    ):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


def photograph(browser: sync_api.Browser, page: Path, name: str, *, part: str | None) -> None:
    """The first screen of a page, or one part of it, as NAME.png and NAME-dark.png."""
    for scheme, ending in (("light", ""), ("dark", "-dark")):
        tab = browser.new_page(viewport={"width": 1200, "height": 800}, color_scheme=scheme)
        tab.goto(page.as_uri())
        tab.wait_for_timeout(3000)  # figures draw themselves
        png = (tab.locator(part).first if part else tab).screenshot()
        tab.close()
        # 256 colours are enough for lines and text, and take a third of the room.
        picture = Image.open(io.BytesIO(png)).convert("RGB").quantize(256)
        picture.save(IMAGES / f"{name}{ending}.png", optimize=True)


def simulator(names: tuple[str, ...], file: str) -> None:
    """Robots as MuJoCo draws their MJCF, beside one another."""
    pictures = []
    for name in names:
        model = mujoco.MjModel.from_xml_string(mjcf(load(name)))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with mujoco.Renderer(model, 1200, 1200) as renderer:
            renderer.update_scene(data, camera="overview")
            pictures.append(Image.fromarray(renderer.render()).resize((400, 400)))
    sheet = Image.new("RGB", (400 * len(pictures), 400))
    for k, picture in enumerate(pictures):
        sheet.paste(picture, (400 * k, 0))
    sheet.quantize(128).save(IMAGES / file, optimize=True)


def main() -> None:
    simulator(("irb360-6-1600", "h4", "linear-delta"), "mjcf.png")
    with tempfile.TemporaryDirectory() as temporary, sync_api.sync_playwright() as playwright:
        folder = Path(temporary)
        prepare(folder)
        svg = recorded_terminal(SESSION, folder)
        (IMAGES / "terminal.svg").write_text(svg, encoding="utf-8")
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--enable-unsafe-swiftshader"],
        )
        for name in ROBOTS:
            page = folder / f"{name}.html"
            subprocess.run(["deltaid", "show", name, "-o", page], check=True, capture_output=True)
            photograph(browser, page, name, part=".js-plotly-plot")
        excited = ["deltaid", "excite", "demo/robot.yaml", "-o", "m.csv", "--starts", "1"]
        subprocess.run([*excited, "--report", "excitation.html"], cwd=folder, check=True)
        for name in ("report", "excitation"):
            photograph(browser, folder / f"{name}.html", name, part=None)
        browser.close()


if __name__ == "__main__":
    main()
