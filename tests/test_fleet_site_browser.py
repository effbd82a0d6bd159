"""The site of a fleet in headless Chromium: it draws, searches, sorts, and asks nobody."""

from pathlib import Path
from typing import Any

import polars as pl
import pytest
from playwright import sync_api

from fleet_tables import TYPES, write, write_tables
from html_page import HOSTILE
from visit import VISITS, Visit

pytestmark = VISITS


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "plant <b>"
    write_tables(folder, 14, 12, silent=(7,), rising=(0, 2), names={0: HOSTILE})
    path = folder / "drift.parquet"
    earlier = pl.col("horizon") - pl.duration(days=30 * (pl.col("robot") == "R003").cast(pl.Int64))
    pl.read_parquet(path).with_columns(horizon=earlier).write_parquet(path)
    return write(folder).parent


def names(page: Any) -> list[str]:
    """Robots that the table of all shows, in its order."""
    rows = page.locator("figure.searchable tbody tr:visible th, figure.searchable tbody tr:visible "
                        "td:first-child")  # fmt: skip
    return rows.all_text_contents()


def test_robots_are_searched_chosen_and_sorted(browser: sync_api.Browser, site: Path) -> None:
    with Visit(browser, site / "index.html") as visit:
        page = visit.page
        assert len(names(page)) == 14
        page.get_by_role("searchbox").fill("r003 rising")
        assert names(page) == ["R003"]
        page.get_by_role("searchbox").fill("")
        page.get_by_role("combobox", name="like its type").select_option("=no")
        assert names(page) == ["R006"]
        page.get_by_role("combobox", name="like its type").select_option("")
        page.get_by_role("combobox", name="type", exact=True).select_option(f"={TYPES[1]}")
        assert len(names(page)) == 7
        page.get_by_role("combobox", name="type", exact=True).select_option("")
        head = page.get_by_role("button", name="in quarantine")
        head.click()
        assert names(page)[-1] == "R008"
        head.click()
        assert names(page)[0] == "R008"
        page.get_by_role("button", name="robot", exact=True).click()
        assert [name for name in names(page) if name != HOSTILE][:3] == ["R002", "R003", "R004"]
        page.get_by_role("button", name="limit on").click()
        assert names(page)[:2] == ["R003", HOSTILE]  # those without a date come last
        page.get_by_role("button", name="limit on").click()
        assert names(page)[:2] == [HOSTILE, "R003"]
        assert visit.said == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_pages_draw_and_ask_nobody(browser: sync_api.Browser, site: Path, scheme: str) -> None:
    pages = [site / "index.html", site / "types" / f"{TYPES[0]}.html"]
    pages += [page for page in (site / "robots").iterdir() if not page.stem.startswith("R0")]
    assert len(pages) == 3
    for path in pages:
        with Visit(browser, path, width=1280 if scheme == "light" else 390, scheme=scheme) as visit:
            visit.unfold()
            assert visit.page.locator(".js-plotly-plot svg.main-svg").count() > 0
            assert visit.eventually(visit.fits)
            assert visit.said == []
            assert all(address.startswith(site.as_uri()) for address in visit.asked)


def test_one_goes_from_the_fleet_to_a_robot_and_back(browser: sync_api.Browser, site: Path) -> None:
    with Visit(browser, site / "index.html") as visit:
        visit.page.get_by_role("link", name=HOSTILE, exact=True).first.click()
        visit.page.wait_for_selector("html.drawn", state="attached")
        assert visit.page.locator("h1").text_content() == HOSTILE
        visit.page.get_by_role("link", name=TYPES[0]).click()
        assert visit.page.locator("h1").text_content() == TYPES[0]
        visit.page.get_by_role("link", name="Fleet plant <b>").click()
        assert visit.page.locator("h1").text_content() == "Fleet plant <b>"
        assert visit.said == []
