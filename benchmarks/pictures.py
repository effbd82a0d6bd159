"""The pictures of README, docs/gallery.md and docs/export.md, made by the program itself.

    pip install -e '.[test]'
    python benchmarks/pictures.py

writes into docs/images. Pages are photographed in Chromium, in light and in dark colours; the
terminal is an SVG that plays by itself, written by `recorded_terminal`.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
from PIL import Image
from playwright import sync_api

sys.path.insert(0, str(Path(__file__).parent))
from terminal_svg import Shown, recorded_terminal

from deltaid.exports.mjcf import mjcf
from deltaid.model.model import load

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
ROBOTS = ("irb360-6-1600", "h4", "par4-linear", "linear-delta")
SESSION = (
    Shown(
        "deltaid check demo/robot.yaml log.csv --columns columns.yaml --write mended.yaml",
        first=5,
        last=9,
    ),
    Shown(
        "deltaid identify demo/robot.yaml log.csv --columns mended.yaml "
        "--verify other-log.csv -o model.yaml --report report.html"
    ),
    Shown(
        "deltaid forces model.yaml planned.csv --columns planned.yaml --strut-spacing 0.1", first=10
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
