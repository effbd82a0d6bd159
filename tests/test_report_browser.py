"""The report in headless Chromium: it draws, moves, fits, goes dark, prints, and asks nobody."""

import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib.image import imread

from command import run
from visit import VISITS, Visit

pytestmark = VISITS

PAGES = ("identify", "validate", "excite", "sensors", "forces", "simulate", "compare-controllers")


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory, demonstration: Path) -> dict[str, Path]:
    """One report of each command."""
    folder = shutil.copytree(demonstration, tmp_path_factory.mktemp("reports") / "demo")
    verify = folder / "verify.csv"
    pages = {name: folder / f"{name}.html" for name in PAGES}
    model, short = folder / "model.yaml", folder / "short.csv"
    pl.read_csv(verify)[:1000].write_csv(short)
    on_truth = (model, short, "--plant", folder / "truth.yaml", "--report")
    commands = (
        ("validate", folder / "model.yaml", verify, "--report", pages["validate"]),
        ("excite", "clavel-delta3", "--starts", 1, "--duration", 3, "--report", pages["excite"]),
        ("sensors", "clavel-delta3", "--report", pages["sensors"]),
        ("forces", folder / "model.yaml", verify, "--strut-spacing", 0.1, "--report",
         pages["forces"]),
        ("simulate", *on_truth, pages["simulate"]),
        ("compare-controllers", *on_truth, pages["compare-controllers"]),
    )  # fmt: skip
    assert [run(*command).code for command in commands] == [0] * (len(PAGES) - 1)
    return pages


@pytest.mark.parametrize("name", PAGES)
def test_everything_is_drawn_and_nothing_is_asked_for(
    browser, reports: dict[str, Path], name: str
) -> None:
    with Visit(browser, reports[name]) as visit:
        page = visit.page
        visit.unfold()
        expected = page.locator(".drawing").count()
        least = {"identify": 14, "validate": 7, "excite": 3, "sensors": 3, "forces": 1}
        least |= {"simulate": 4}
        assert expected >= least.get(name, 11)
        assert page.locator(".js-plotly-plot svg.main-svg").count() >= expected
        assert page.locator(".no-webgl").count() == 0
        flat = page.evaluate(
            "[...document.querySelectorAll('.drawing')].filter((d) => !d.querySelector('canvas'))"
            ".map((d) => d.querySelectorAll('.trace path, .cartesianlayer image').length)"
        )
        assert min(flat) > 0
        solid = page.locator(".drawing").filter(has=page.locator("canvas"))
        solids = {"identify": 2, "validate": 1, "excite": 1}.get(name, 0)
        assert solid.count() == solids == expected - len(flat)
        for i in range(solid.count()):
            assert _inked(solid.nth(i).locator("canvas").screenshot()) > 0.003
        assert visit.fits()
        page.set_viewport_size({"width": 600, "height": 900})
        assert visit.eventually(visit.fits)
        assert visit.said == []
        assert visit.asked == [reports[name].as_uri()]


def test_the_robot_moves_while_playing_and_stops(browser, reports: dict[str, Path]) -> None:
    with Visit(browser, reports["excite"]) as visit:
        page = visit.page
        player = page.get_by_role("group", name="Animation")
        assert player.count() == 1
        plot = page.locator(".drawing").filter(has=page.locator("canvas"))
        arms = "p => [...p._fullData.find((t) => t.name === 'upper arms').z].filter(isFinite)"
        before, seen = plot.evaluate(arms), plot.screenshot()

        def moved() -> bool:
            return np.abs(np.subtract(plot.evaluate(arms), before)).max() > 0.01

        player.get_by_role("button", name="Play").focus()
        page.keyboard.press("Space")
        assert visit.eventually(moved)
        # A busy machine draws late, and the motion passes its first pose again and again.
        assert visit.eventually(lambda: _changed(seen, plot.screenshot()) > 0.001)
        page.keyboard.press("Space")
        page.wait_for_timeout(500)
        stopped = plot.evaluate(arms)
        page.wait_for_timeout(500)
        assert plot.evaluate(arms) == stopped
        assert visit.said == []


def test_keys_step_through_an_animation(browser, reports: dict[str, Path]) -> None:
    with Visit(browser, reports["excite"]) as visit:
        page = visit.page
        player = page.get_by_role("group", name="Animation")
        slider, time = player.get_by_role("slider"), player.locator("output")
        assert time.text_content() == slider.get_attribute("aria-valuetext")
        for _ in range(200):
            page.keyboard.press("Tab")
            if slider.evaluate("e => e === document.activeElement"):
                break
        outline = slider.evaluate("e => getComputedStyle(e).outlineStyle")
        assert outline not in ("none", "")
        page.keyboard.press("End")
        last = slider.input_value()
        assert int(last) > 50
        assert slider.get_attribute("max") == last
        page.keyboard.press("ArrowLeft")
        assert int(slider.input_value()) == int(last) - 1
        player.get_by_role("button", name="Step").press("Enter")
        player.get_by_role("button", name="Step").press("Enter")
        assert slider.input_value() == "0"
        player.get_by_role("button", name="Back").press("Enter")
        assert slider.input_value() == last
        assert visit.said == []


def test_time_axes_zoom_together(browser, reports: dict[str, Path]) -> None:
    with Visit(browser, reports["validate"]) as visit:
        plot = visit.page.locator(".drawing").first
        panel = plot.locator(".nsewdrag").first
        panel.scroll_into_view_if_needed()
        visit.page.wait_for_timeout(1000)  # until it stands still
        box = panel.bounding_box()
        middle = box["y"] + box["height"] / 2
        visit.page.mouse.move(box["x"] + 0.4 * box["width"], middle)
        visit.page.mouse.down()
        visit.page.mouse.move(box["x"] + 0.6 * box["width"], middle, steps=5)
        visit.page.mouse.up()
        read = """p => Object.keys(p._fullLayout).filter((k) => /^xaxis[0-9]*$/.test(k))
            .map((k) => p._fullLayout[k].range)"""
        assert visit.eventually(lambda: plot.evaluate(read)[0][0] > 5)
        ranges = plot.evaluate(read)
        assert len(ranges) == 8
        assert ranges == [ranges[0]] * 8
        low, high = ranges[0]
        assert 7 < low < 9 < 11 < high < 13


def test_a_phone_scrolls_only_downwards(browser, reports: dict[str, Path]) -> None:
    with Visit(browser, reports["identify"], width=390) as visit:
        assert visit.fits()
        visit.unfold()
        assert visit.eventually(visit.fits)
        tables = visit.page.locator(".scroll")
        assert any(
            tables.nth(i).evaluate("box => box.scrollWidth > box.clientWidth")
            for i in range(tables.count())
        )
        assert visit.said == []


@pytest.mark.parametrize("name", PAGES)
def test_tables_fit_on_paper(browser, reports: dict[str, Path], name: str) -> None:
    with Visit(browser, reports[name], width=680) as visit:  # A4 with its margins
        visit.unfold()
        visit.page.emulate_media(media="print")
        widths = "[...document.querySelectorAll('table')].map((t) => t.offsetWidth)"
        assert visit.eventually(lambda: max(visit.page.evaluate(widths)) <= 680)


def test_dark_light_and_paper(browser, reports: dict[str, Path]) -> None:
    with Visit(browser, reports["excite"], scheme="dark") as visit:
        visit.unfold()
        tick = ".drawing .xtick text"
        assert visit.brightness("body", "backgroundColor") < 60
        assert visit.brightness("body") > 190
        assert visit.brightness(tick, "fill") > 190
        assert visit.page.pdf()[:4] == b"%PDF"
        assert visit.eventually(lambda: visit.brightness(tick, "fill") > 190)
        assert visit.eventually(visit.fits)
        visit.page.emulate_media(color_scheme="light")
        assert visit.eventually(lambda: visit.brightness(tick, "fill") < 70)
        assert visit.brightness("body", "backgroundColor") > 240
        visit.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        widths = "[...document.querySelectorAll('.drawing')].map((p) => p._fullLayout.width)"
        assert visit.eventually(lambda: visit.page.evaluate(widths) == [680] * 3)
        assert visit.said == []


def _pixels(png: bytes) -> np.ndarray:
    return imread(BytesIO(png), format="png")[:, :, :3]


def _inked(png: bytes) -> float:
    """Share of pixels that are coloured, not grey."""
    pixels = _pixels(png)
    return float(np.mean(np.ptp(pixels, axis=2) > 0.2))


def _changed(before: bytes, after: bytes) -> float:
    """Share of pixels that differ between two pictures of one size."""
    return float(np.mean(np.abs(_pixels(before) - _pixels(after)).max(axis=2) > 0.1))


def test_a_page_in_a_frame_has_the_colours_of_the_page_around_it(browser, tmp_path: Path) -> None:
    path = tmp_path / "check.html"
    assert run("check", "clavel-delta3", "--report", path).code == 0
    page = browser.new_page(color_scheme="light")
    page.goto(f"{path.as_uri()}?theme=dark")

    def paper() -> str:
        return page.evaluate("getComputedStyle(document.body).backgroundColor")

    assert paper() == "rgb(18, 22, 27)"
    for theme, colour in (("light", "rgb(255, 255, 255)"), ("dark", "rgb(18, 22, 27)")):
        page.evaluate("theme => window.postMessage({ theme }, '*')", theme)
        page.wait_for_selector(f"html[data-theme={theme}]", state="attached")
        assert paper() == colour
    page.emulate_media(media="print")
    assert paper() == "rgb(255, 255, 255)"
    page.close()
