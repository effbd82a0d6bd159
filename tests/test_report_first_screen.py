"""What a report says first: on screen and on two printed pages, in words that it explains."""

import re
from dataclasses import replace
from pathlib import Path

import pypdfium2
import pytest
from playwright import sync_api

from deltaid.identification.prediction import validate
from deltaid.model.model import load
from deltaid.model.verdict import Grade, Verdict
from deltaid.view.check import short_table
from deltaid.view.html import write_page
from deltaid.view.model_pages import validation_page
from visit import VISITS, Visit

pytestmark = VISITS

BODIES = ("U", "S", "P", "TU", "TL", "EE")
VERDICT = "Good: predicts torques of an unseen motion within"
# Contrast of text and background after WCAG 2.2: (L₁ + 0.05) / (L₂ + 0.05).
CONTRAST = """(selector) => {
  const [paint] = [document.createElement("canvas").getContext("2d")];
  const rgb = (color) => {
    paint.fillStyle = color; paint.fillRect(0, 0, 1, 1);
    return [...paint.getImageData(0, 0, 1, 1).data].slice(0, 3).map((v) => v / 255);
  };
  const light = (color) => rgb(color)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  return [...document.querySelectorAll(selector)].map((element) => {
    let behind = element;
    const back = (e) => getComputedStyle(e).backgroundColor;
    const clear = (e) => /rgba\\(.*, 0\\)/.test(back(e));
    while (clear(behind) && behind.parentElement) behind = behind.parentElement;
    const style = getComputedStyle(element);
    const ink = element instanceof SVGElement ? style.fill : style.color;
    const pair = [light(ink), light(back(behind))].sort((a, b) => b - a);
    return (pair[0] + 0.05) / (pair[1] + 0.05);
  });
}"""


@pytest.fixture(scope="module")
def report(demonstration: Path) -> Path:
    """The report of the demonstration, verified."""
    return demonstration / "identify.html"


def printed(visit: Visit) -> list[str]:
    """Texts of the pages that are printed."""
    document = pypdfium2.PdfDocument(visit.page.pdf(prefer_css_page_size=True))
    return [page.get_textpage().get_text_range() for page in document]


def test_the_first_screen_has_verdict_drawing_and_command(
    browser: sync_api.Browser, report: Path
) -> None:
    with Visit(browser, report, width=1400) as visit:
        page = visit.page

        def is_seen(element: sync_api.Locator) -> bool:
            box = element.bounding_box()
            return box is not None and box["y"] + box["height"] <= 900

        verdict = page.get_by_role("group", name="Verdict")
        assert VERDICT in (verdict.text_content() or "")
        assert is_seen(verdict)
        drawing = page.locator("svg.robot")
        assert is_seen(drawing)
        assert set(BODIES) <= set(drawing.locator("text").evaluate_all(
            "all => all.map((t) => t.firstChild.textContent)"
        ))  # fmt: skip
        made = page.locator(".made")
        assert is_seen(made)
        assert re.search(
            r"deltaid identify \S+robot.yaml .* on \d{4}-\d\d-\d\d .*, deltaid \d",
            made.text_content() or "",
        )
        assert is_seen(page.get_by_text("all checks"))


def test_names_in_the_drawing_keep_apart_and_inside(
    browser: sync_api.Browser, report: Path
) -> None:
    with Visit(browser, report, width=1400) as visit:
        boxes = visit.page.locator("svg.robot text").evaluate_all(
            "all => all.map((t) => t.getBoundingClientRect())"
            ".map((r) => [r.x, r.y, r.right, r.bottom])"
        )
        x, y, right, bottom = visit.page.locator("svg.robot").evaluate(
            "(s) => { const r = s.getBoundingClientRect(); return [r.x, r.y, r.right, r.bottom]; }"
        )
        for i, a in enumerate(boxes):
            assert x <= a[0]
            assert a[2] <= right
            assert y <= a[1]
            assert a[3] <= bottom + 1
            for b in boxes[:i]:
                assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] + 2 or b[3] <= a[1] + 2


def test_two_printed_pages_say_it(browser: sync_api.Browser, report: Path) -> None:
    with Visit(browser, report) as visit:
        first, second = printed(visit)
        first = " ".join(first.split())
        for said in (VERDICT, "upper arm", "telescope bar", "Made by deltaid identify"):
            assert said in first
        for said in ("all checks", "torque error, N m", "drive4"):
            assert said in first
        assert "measured" in second
        assert "predicted" in second
        assert "SHA-256" not in first + second
        # What is unfolded is on paper too, but nothing that would have to move there.
        for chapter in ("Data and settings", "Motion"):
            visit.page.locator("summary", has_text=chapter).click()
        visit.page.wait_for_selector(".player")
        visit.page.wait_for_selector("html.drawn", state="attached")
        text = "".join(printed(visit))
        assert "SHA-256" in text
        assert "Motion" in text
        assert "in real time" not in text
        assert "▾" not in text


def test_doubts_do_not_take_a_third_page(
    browser: sync_api.Browser, report: Path, tmp_path: Path
) -> None:
    said = "of the torques follow the position and are not explained, neither by this nor by that"
    doubts = [
        Verdict(f"check-{k}", Grade.DOUBTFUL, f"{k} % {said}", cause=said, cure="measure anew")
        for k in range(6)
    ]
    model = load(report.parent / "model.yaml")
    page = validation_page(validate(model, report.parent / "verify.csv"))
    write_page(replace(page, front=(short_table(doubts), *page.front)), tmp_path / "page.html")
    with Visit(browser, tmp_path / "page.html") as visit:
        assert len(printed(visit)) == 2


def test_every_short_name_is_explained(browser: sync_api.Browser, report: Path) -> None:
    with Visit(browser, report) as visit:
        page = visit.page
        tables = page.locator("figure.table")
        seen = set()
        for i in range(tables.count()):
            table = tables.nth(i)
            cells = table.locator("td, th")
            bare = cells.evaluate_all(
                "all => all.map((c) => { const o = c.cloneNode(true);"
                "o.querySelectorAll('abbr[title]').forEach((a) => a.remove());"
                "return o.textContent; })"
            )
            names = rf"\b({'|'.join(BODIES)})(\.\w|\b)|_({'|'.join(BODIES)})\b"
            assert not [text for text in bare if re.search(names, text)]
            short = table.locator("abbr").evaluate_all("all => all.map((a) => a.textContent)")
            bodies = {b for text in short for b in BODIES if re.search(rf"(\b|_){b}(\b|\.)", text)}
            legend = table.locator("figcaption").text_content() or "" if bodies else ""
            assert all(re.search(rf"\b{body} \w", legend) for body in bodies)
            seen |= bodies
        assert seen == set(BODIES)
        titles = page.locator("abbr").evaluate_all(
            "all => all.map((a) => [a.textContent, a.title])"
        )
        assert ["U.mcx", "upper arm: mass times centre of mass along x"] in titles
        assert ["TU", "upper telescope bar"] in titles


def test_links_unfold_their_chapter(browser: sync_api.Browser, report: Path) -> None:
    with Visit(browser, report) as visit:
        page = visit.page
        chapter = page.locator("details.section").filter(has=page.locator("h2", has_text="Bodies"))
        assert not chapter.evaluate("d => d.open")
        page.get_by_role("link", name="Bodies").click()
        assert visit.eventually(lambda: chapter.evaluate("d => d.open"))
        assert visit.eventually(lambda: chapter.locator(".js-plotly-plot canvas").count() > 0)
        chapter.locator("summary").focus()
        page.keyboard.press("Enter")
        assert visit.eventually(lambda: not chapter.evaluate("d => d.open"))
        assert visit.said == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read(browser: sync_api.Browser, report: Path, scheme: str) -> None:
    with Visit(browser, report, scheme=scheme) as visit:
        texts = "p, dt, dd, li, a, button, th, td, figcaption, .about, h2, svg.robot text, .words"
        found = visit.page.evaluate(CONTRAST, texts)
        assert len(found) > 100
        assert min(found) >= 4.5
